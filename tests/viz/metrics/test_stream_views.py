"""Views of each stream, windows of them, pairs, and epipolar-plane images, against the slow way."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gazenerf.errors import UserError
from gazenerf.geometry import Camera
from gazenerf.heads.interface import PARTS, Part
from gazenerf.viz.metrics.epipolar import epipolar_strips, strip_cameras
from gazenerf.viz.metrics.pairs import angle_between, load_perceptual, measure_pair, view_pairs
from gazenerf.viz.metrics.stream_views import render_streams, window_around
from gazenerf.viz.selftest.exact_scene import FEATURE_PIXELS, SmoothScene
from gazenerf.workers import pool


def test_the_face_rendered_in_a_window_is_the_face():
    scene, camera = SmoothScene(), Camera.orbit(0.3, size=96)
    view = render_streams(scene, camera)
    whole = scene.render_geometry(camera, "face")
    assert np.array_equal(view.geometry["face"].depth, whole.depth, equal_nan=True)
    assert not np.array_equal(view.geometry["head"].depth, whole.depth, equal_nan=True), "eyes stand out"
    assert view.feature_width == 96 // FEATURE_PIXELS
    behind = render_streams(scene, Camera.orbit(np.pi, size=64))
    assert np.array_equal(behind.geometry["face"].depth, behind.geometry["head"].depth, equal_nan=True)


def test_a_window_shows_what_the_picture_shows_there():
    scene, camera = SmoothScene(), Camera.orbit(0.2, 0.1, size=128)
    centres = np.stack([eye.centre for eye in scene.eyes])
    window = window_around(camera, centres, 0.24)
    part = camera.windowed(window)
    assert np.allclose(scene.render(part).image, scene.render(camera).image[window], atol=1e-6)
    assert all(edge % 16 == 0 for side in window for edge in (side.start, side.stop))
    pixels, _ = camera.project(centres)
    assert (pixels[:, 0] > window[1].start).all() and (pixels[:, 1] < window[0].stop).all()
    with pytest.raises(UserError, match="do not see the head"):
        window_around(camera, centres + np.array([9.0, 0.0, 0.0]), 0.1)


def test_pairs_are_short_or_long_and_each_once():
    cameras = [Camera.orbit(np.deg2rad(yaw), size=32) for yaw in (0, 30, 5, 17)]
    pairs = view_pairs(cameras)
    assert [(i, j, reach) for i, j, _, reach in pairs] == [(0, 1, "long"), (0, 2, "short"), (1, 2, "long")]
    assert angle_between(cameras[0], cameras[2]) == pytest.approx(5.0)


@pytest.mark.parametrize("part", ["head", "face", "eyes"])
def test_a_stream_that_disagrees_is_told_from_the_others(part: Part):
    scene = SmoothScene()
    cameras = [Camera.orbit(np.deg2rad(yaw), size=128) for yaw in (0.0, 5.0)]
    a, b = (render_streams(scene, camera) for camera in cameras)
    eyes = (np.stack([eye.centre for eye in scene.eyes]), 0.12)
    shifted = replace(b, images=b.images | {part: np.roll(b.images[part], 6, axis=1)})
    clean, _ = measure_pair(("a", "b"), (a, b), 5.0, "short", eyes, 0.1)
    broken, _ = measure_pair(("a", "b"), (a, shifted), 5.0, "short", eyes, 0.1)
    assert broken[part].whole.warp_psnr < clean[part].whole.warp_psnr - 8.0
    assert broken[part].whole.warp_ssim < clean[part].whole.warp_ssim
    assert all(broken[other] == clean[other] for other in PARTS if other != part)
    assert clean["eyes"].whole.covisible < clean["head"].whole.covisible / 10, "inside the eyes alone"
    assert clean["head"].eye_region.covisible < clean["head"].whole.covisible / 4


def test_lpips_is_an_extra():
    perceptual = load_perceptual()
    if perceptual is None:
        pytest.skip("LPIPS weights are not installed: pip install 'gazenerf[perceptual]'")
    image = np.random.default_rng(0).uniform(size=(64, 64, 3)).astype(np.float32)
    assert perceptual(image, image) == pytest.approx(0.0, abs=1e-6)
    assert perceptual(image, 1.0 - image) > 0.1
    assert np.isnan(perceptual(image[:16], image[:16]))


def test_a_strip_is_the_row_of_every_frame():
    scene = SmoothScene()
    strips = epipolar_strips(
        scene, {"eyes": np.array([0.0, 0.1, 0.9]), "mouth": np.array([0.0, -0.6, 0.7])}, 96, frames=5
    )
    front = Camera.orbit(0.0, size=96)
    for name, y in (("eyes", 0.1), ("mouth", -0.6)):
        row = int(front.project(np.array([0.0, y, 0.9 if name == "eyes" else 0.7]))[0][1])
        slow = np.stack([scene.render(camera).image[row] for camera in strip_cameras(96, 5)])
        assert np.allclose(strips[name], slow, atol=1e-6)


def test_texture_on_the_screen_draws_vertical_lines():
    point = {"eyes": np.array([0.0, -0.3, 0.9])}
    alive, glued = (
        epipolar_strips(scene, point, 96, frames=8)["eyes"] for scene in (SmoothScene(), SmoothScene(glued=True))
    )
    middle = slice(36, 60)
    assert np.ptp(glued[:, middle], axis=0).max() < 1e-6 < np.ptp(alive[:, middle], axis=0).mean()


def test_threads_give_what_one_thread_gives():
    scene, cameras = SmoothScene(), strip_cameras(48, 6)
    with pool(3) as executor:
        both = list(executor.map(lambda camera: scene.render(camera).image, cameras))
    assert all(np.array_equal(image, scene.render(c).image) for image, c in zip(both, cameras, strict=True))
