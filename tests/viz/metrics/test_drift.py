"""Pictures moved, outgrown or painted over by a known amount against their volume."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from gazenerf.geometry import Camera
from gazenerf.viz.metrics.drift import outline_shift, picture_shift, picture_silhouette, texture_follow, view_drift
from gazenerf.viz.metrics.reprojection import carry
from gazenerf.viz.selftest.exact_scene import SmoothScene

SIZE = 128


def moved(image: np.ndarray, x: float, y: float) -> np.ndarray:
    """A picture shifted right and down."""
    return ndimage.shift(image.astype(np.float64), (y, x, 0.0), order=3, mode="nearest")


@pytest.fixture(scope="module")
def front():
    camera, scene = Camera.orbit(0.3, 0.1, size=SIZE), SmoothScene()
    head, eyes = (scene.render_geometry(camera, part, normals=part == "head") for part in ("head", "eyes"))
    return scene.render(camera).image, head, eyes


@pytest.mark.parametrize("offset", [(2.0, 0.0), (0.5, -0.7), (-1.5, 1.25)])
def test_a_shift_of_the_picture_is_read_to_a_tenth_of_a_pixel(front, offset):
    image, head, eyes = front
    still, explained = picture_shift(image, head, eyes)
    found, _ = picture_shift(moved(image, *offset), head, eyes)
    assert explained > 0.8
    assert np.subtract(found, still) == pytest.approx(offset, abs=0.02), "of the same picture"
    assert np.linalg.norm(still) < 0.35, "what the pattern itself is mistaken for"
    black = np.zeros(3)
    outline = outline_shift(picture_silhouette(moved(image, *offset), black), np.isfinite(head.depth))
    assert outline == pytest.approx(offset, abs=0.2), "its edge is known to a pixel"


def test_growth_is_no_shift_but_lowers_the_overlap(front):
    image, head, eyes = front
    grown = np.where(ndimage.binary_dilation(np.isfinite(head.depth), iterations=2)[..., None], image + 0.3, image)
    found = view_drift("a", grown, np.zeros(3), head, eyes)
    assert found.iou < 0.95 < view_drift("a", image, np.zeros(3), head, eyes).iou
    assert np.abs(found.outline_px).max() < 0.1


def test_a_picture_of_something_else_is_not_explained(front):
    image, head, eyes = front
    noise = np.random.default_rng(0).uniform(size=image.shape)
    assert picture_shift(noise, head, eyes)[1] < 0.2
    empty = view_drift("a", np.zeros_like(image), np.zeros(3), head, eyes)
    assert empty.iou == 0.0 and np.isnan(empty.outline_px).all()


def test_dark_spots_inside_belong_to_the_silhouette():
    image = np.zeros((40, 40, 3))
    image[8:32, 8:32] = 0.5
    image[15:18, 15:18] = 0.0
    image[0:2, 0:2] = 1.0
    mask = picture_silhouette(image, np.zeros(3))
    assert mask[16, 16] and not mask[0, 0] and mask.sum() == 24 * 24


@pytest.mark.parametrize("yaw", [5.0, 30.0])
def test_texture_on_the_surface_follows_and_texture_on_the_screen_stays(yaw):
    scene = SmoothScene()
    cameras = [Camera.orbit(np.deg2rad(angle), size=192) for angle in (0.0, yaw)]
    views, images = [scene.render_geometry(c) for c in cameras], [scene.render(c).image for c in cameras]
    carried, depths = carry(*views), (views[0].depth, views[1].depth)
    exact = texture_follow("a", "b", (images[0], images[1]), depths, carried)
    assert exact.unfollowed < 0.01 and abs(exact.stuck) < 0.15
    grain = ndimage.gaussian_filter(np.random.default_rng(0).normal(size=images[0].shape), (1.0, 1.0, 0.0))
    stuck = texture_follow("a", "b", (images[0] + grain, images[1] + grain), depths, carried)
    assert stuck.unfollowed == pytest.approx(1.0, abs=0.15) and stuck.stuck > 0.95
    other = ndimage.gaussian_filter(np.random.default_rng(1).normal(size=images[0].shape), (1.0, 1.0, 0.0))
    flicker = texture_follow("a", "b", (images[0] + grain, images[1] + other), depths, carried)
    assert flicker.unfollowed == pytest.approx(1.0, abs=0.15) and abs(flicker.stuck) < 0.15, "neither follows nor stays"
