import numpy as np
import pytest

from gazenerf.geometry import Camera
from gazenerf.viz.pictures.colormaps import (
    MAPS,
    apply_colormap,
    colour_depth,
    colour_normals,
    colour_opacity,
    enlarge,
    fill_holes,
)


@pytest.mark.parametrize("name", [name for name in MAPS if name != "turbo"])
def test_lightness_rises_with_the_value(name):
    colours = apply_colormap(np.linspace(0, 1, 64)[None], name)[0].astype(float)
    lightness = colours @ [0.2126, 0.7152, 0.0722]
    assert (np.diff(lightness) > -1.5).all() and lightness[-1] - lightness[0] > 120


def test_viridis_ends_are_rgb_not_bgr():
    low, high = apply_colormap(np.array([[0.0, 1.0]]))[0].astype(int)
    assert low[2] > low[0] > low[1] and high[0] > 200 and high[1] > 200 and high[2] < 90


def test_holes_take_their_nearest_value():
    values = np.array([[1.0, np.nan, np.nan, 5.0]])
    np.testing.assert_array_equal(fill_holes(values), [[1.0, 1.0, 5.0, 5.0]])
    assert not fill_holes(np.full((2, 2), np.nan)).any()


def test_enlarging_keeps_the_mean_and_place():
    values = np.zeros((8, 8), np.float32)
    values[2, 5] = 1.0
    big = enlarge(values, 32, 32)
    y, x = np.average(np.mgrid[:32, :32].reshape(2, -1) + 0.5, axis=1, weights=big.ravel())
    assert big.mean() == pytest.approx(values.mean(), rel=1e-5)
    assert (y, x) == pytest.approx((2.5 * 4, 5.5 * 4))


def test_depth_is_bright_near_and_background_where_nothing_is():
    depth = np.array([[10.0, 11.0, 12.0, np.nan]], np.float32)
    shown = colour_depth(depth, np.array([[1, 1, 1, 0]], np.float32), 10.0, 12.0, background=(1.0, 0.0, 0.0))[0]
    lightness = shown.astype(float) @ [0.2126, 0.7152, 0.0722]
    assert lightness[0] > lightness[1] > lightness[2]
    np.testing.assert_array_equal(shown[3], [255, 0, 0])
    with pytest.raises(ValueError, match="below"):
        colour_depth(depth, depth, 3.0, 3.0)


def test_normals_are_seen_from_the_camera():
    camera = Camera.orbit(np.deg2rad(90), size=4)
    toward = np.broadcast_to([1.0, 0.0, 0.0], (4, 4, 3))
    shown = colour_normals(toward, np.ones((4, 4)), camera)
    np.testing.assert_allclose(shown[0, 0], [128, 128, 255], atol=1)
    right = np.broadcast_to([0.0, 0.0, -1.0], (4, 4, 3))  # from the subject's left, its back is at the right
    np.testing.assert_allclose(colour_normals(right, np.ones((4, 4)), camera)[0, 0], [255, 128, 128], atol=1)


def test_opacity_is_grey():
    np.testing.assert_array_equal(colour_opacity(np.array([[0.0, 1.0]])), [[[0, 0, 0], [255, 255, 255]]])
