"""TSED on a scene whose pictures are exact: perfect with its cameras, lost with others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gazenerf.geometry import Camera
from gazenerf.heads.analytic import AnalyticField
from gazenerf.viz.metrics.tsed import MIN_MATCHES, fundamental, measure_tsed, neighbours, symmetric_epipolar_distance
from tests.textured_double import TexturedField

ORBIT = [Camera.orbit(np.deg2rad(yaw), np.deg2rad(5.0), size=160) for yaw in range(-24, 25, 8)]
CONSECUTIVE = [(i, i + 1) for i in range(len(ORBIT) - 1)]


def pictures(field: AnalyticField) -> list[np.ndarray]:
    return [field.render(camera).image for camera in ORBIT]


@pytest.fixture(scope="module")
def exact() -> list[np.ndarray]:
    return pictures(TexturedField())


def test_an_exact_scene_scores_one_and_wrong_cameras_score_nothing(exact):
    good = measure_tsed(exact, ORBIT, CONSECUTIVE)
    assert len(good.pairs) == len(ORBIT) - 1
    assert good.score() == 1.0 and good.median_px < 0.5 and good.median_matches > 5 * MIN_MATCHES
    wrong = [camera_pitched(camera, 3.0 * (-1) ** i) for i, camera in enumerate(ORBIT)]
    bad = measure_tsed(exact, wrong, CONSECUTIVE)
    assert bad.score() == 0.0 and bad.median_px > 2.0
    assert bad.median_matches == good.median_matches, "matching does not look at the cameras"


def camera_pitched(camera: Camera, degrees: float) -> Camera:
    """The camera turned about its own x axis."""
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    turn = np.array([[1, 0, 0, 0], [0, c, -s, 0], [0, s, c, 0], [0, 0, 0, 1.0]])
    return replace(camera, world_from_camera=camera.world_from_camera @ turn)


def test_a_shift_of_the_picture_across_the_lines_is_read_in_pixels(exact):
    moved = [np.roll(image, 3 * (i % 2), axis=0) for i, image in enumerate(exact)]
    shifted = measure_tsed(moved, ORBIT, CONSECUTIVE)
    assert shifted.median_px == pytest.approx(3.0, abs=0.3)
    assert shifted.score(2.0) == 0.0 and shifted.score(4.0) == 1.0


def test_a_picture_without_texture_has_no_consistent_pair_and_says_how_few_matches():
    plain = [np.full((160, 160, 3), 0.5, np.float32) for _ in ORBIT]
    result = measure_tsed(plain, ORBIT)
    assert result.score() == 0.0 and result.median_matches == 0 and result.too_few == len(result.pairs)
    assert np.isnan(result.median_px)


def test_the_fundamental_matrix_annihilates_every_projected_point():
    points = np.random.default_rng(0).normal(size=(50, 3))
    a, b = ORBIT[0], Camera.orbit(0.7, 0.3, size=(200, 120))
    f = fundamental(a, b)
    pa, pb = a.project(points)[0], b.project(points)[0]
    assert symmetric_epipolar_distance(f, pa, pb).max() < 1e-8
    off = pb + np.array([0.0, 1.0])
    line = np.c_[pa, np.ones(50)] @ f.T
    mine = np.abs((np.c_[off, np.ones(50)] * line).sum(1)) / np.hypot(line[:, 0], line[:, 1])
    back = np.c_[off, np.ones(50)] @ f
    other = np.abs((np.c_[pa, np.ones(50)] * back).sum(1)) / np.hypot(back[:, 0], back[:, 1])
    assert symmetric_epipolar_distance(f, pa, off) == pytest.approx(0.5 * (mine + other))
    with pytest.raises(ValueError, match="one centre"):
        fundamental(a, a)


def test_neighbours_of_a_shuffled_orbit_are_the_consecutive_frames():
    order = np.random.default_rng(1).permutation(12)
    ring = [Camera.orbit(np.deg2rad(30.0 * i), size=32) for i in order]
    place = {int(frame): i for i, frame in enumerate(order)}
    expected = sorted(tuple(sorted((place[i], place[(i + 1) % 12]))) for i in range(12))
    assert neighbours(ring) == expected
    assert neighbours([ring[0], ring[0]]) == [] and neighbours([]) == []
    assert neighbours([Camera.orbit(0.0), Camera.orbit(np.deg2rad(40.0))]) == []


def test_pictures_must_fit_their_cameras(exact):
    with pytest.raises(ValueError, match="for a camera of"):
        measure_tsed([image[:-1] for image in exact], ORBIT)
    with pytest.raises(ValueError, match="cameras"):
        measure_tsed(exact, ORBIT[:-1])
