"""The browser's camera as this project's."""

import numpy as np
import pytest

from gazenerf.geometry import Camera
from gazenerf.geometry.cameras import NEUTRAL_FOV
from gazenerf.viz.viewer.viewpoint import Viewpoint

FACING = (0.0, 1.0, 0.0, 0.0)
"""Half a turn about X: OpenCV axes that look along -Z, Y up."""


def viewpoint(width=1100, height=800, **changes) -> Viewpoint:
    values = {"wxyz": FACING, "position": (0.0, 0.0, 12.0), "fov": NEUTRAL_FOV, "width": width, "height": height}
    return Viewpoint(**(values | changes))


def test_a_square_page_in_front_of_the_head_is_the_neutral_camera():
    found, wanted = viewpoint(700, 700).camera(256, 4), Camera.neutral(256)
    np.testing.assert_allclose(found.world_from_camera, wanted.world_from_camera, atol=1e-12)
    np.testing.assert_allclose(found.intrinsics, wanted.intrinsics, atol=1e-9)
    assert (found.width, found.height) == (256, 256)


@pytest.mark.parametrize(("width", "height"), [(1100, 800), (500, 1301), (800, 800)])
@pytest.mark.parametrize("shorter", [64, 255])
def test_the_picture_covers_the_page_whatever_its_size(width, height, shorter):
    camera = viewpoint(width, height).camera(shorter, 4)
    top, side = 12.0 * np.tan(NEUTRAL_FOV / 2), 12.0 * np.tan(NEUTRAL_FOV / 2) * width / height
    pixels, z = camera.project(np.array([[0.0, top, 0.0], [side, 0.0, 0.0], [-side, -top, 0.0]]))
    np.testing.assert_allclose(pixels[0], [camera.width / 2, 0.0], atol=1e-6)
    np.testing.assert_allclose(pixels[1], [camera.width, camera.height / 2], atol=1e-6)
    np.testing.assert_allclose(pixels[2], [0.0, camera.height], atol=1e-6)
    assert camera.width % 4 == camera.height % 4 == 0 and abs(min(camera.width, camera.height) - shorter) <= 2
    assert (z > 0).all()


def test_the_subjects_left_is_at_the_right_of_the_picture_and_up_is_up():
    camera = viewpoint().camera(128)
    (pixel,), _ = camera.project(np.array([[0.5, 0.5, 0.0]]))
    assert pixel[0] > camera.width / 2 and pixel[1] < camera.height / 2


def test_a_very_long_page_gets_a_bounded_picture():
    camera = viewpoint(100_000, 10).camera(512, 4)
    assert max(camera.width, camera.height) <= 4 * 512 and min(camera.width, camera.height) >= 1


@pytest.mark.parametrize(
    "changes",
    [
        {"width": 0},
        {"height": -1},
        {"fov": 0.0},
        {"fov": np.pi},
        {"fov": np.nan},
        {"position": (0.0, np.nan, 1.0)},
        {"wxyz": (0.0, 0.0, 0.0, 0.0)},
        {"wxyz": (np.inf, 0.0, 0.0, 0.0)},
    ],
)
def test_what_no_camera_has_is_refused(changes):
    with pytest.raises(ValueError):
        viewpoint(**changes)
