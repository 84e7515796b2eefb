"""The gaze pad in the scene: where a pointer looks, from every side, and what its border is."""

import numpy as np
import pytest

from gazenerf.geometry import Camera, Gaze
from gazenerf.geometry.paths import GazeRange
from gazenerf.viz.viewer.gaze_pad import RADIUS, pad_lines, pad_point, pointed_gaze

EYES, LIMITS = np.array([0.0, 0.1, 0.8]), GazeRange(float(np.deg2rad(25.0)), float(np.deg2rad(35.0)))


@pytest.mark.parametrize("yaw", [0.0, 0.9, -1.2])
@pytest.mark.parametrize("degrees", [(0.0, 0.0), (12.0, -30.0), (-20.0, 25.0)])
def test_a_pointer_on_the_pad_is_the_gaze_that_goes_there(yaw, degrees):
    camera = Camera.orbit(yaw, 0.2).position
    gaze = Gaze.from_degrees(*degrees)
    for share in (0.3, 1.0, 1.4):
        pointer = camera + share * (pad_point(EYES, gaze) - camera)
        found = pointed_gaze(EYES, camera, pointer, LIMITS, Gaze.from_degrees(degrees[0] + 3.0, degrees[1] - 2.0))
        assert found is not None and found.degrees == pytest.approx(degrees, abs=1e-6)


def test_what_is_beyond_the_border_or_beside_the_pad_is_held_at_the_border():
    camera = np.array([0.0, 0.0, 12.0])
    beyond = pointed_gaze(EYES, camera, pad_point(EYES, Gaze.from_degrees(0.0, 50.0)), LIMITS, Gaze())
    beside = pointed_gaze(EYES, camera, np.array([5.0, 0.1, 0.8]), LIMITS, Gaze())
    assert beyond is not None and beyond.degrees[1] == pytest.approx(35.0)
    assert beside is not None and beside.degrees[1] == pytest.approx(35.0) and abs(beside.degrees[0]) < 5.0
    assert pointed_gaze(EYES, camera, camera, LIMITS, Gaze()) is None
    assert pointed_gaze(EYES, camera, np.array([np.nan, 0.0, 0.0]), LIMITS, Gaze()) is None


def test_the_border_is_the_range():
    points = pad_lines(EYES, LIMITS).reshape(-1, 3)
    assert np.linalg.norm(points - EYES, axis=1) == pytest.approx(RADIUS, abs=1e-5)
    angles = np.array([Gaze.from_vector(point - EYES).degrees for point in points])
    assert np.abs(angles).max(axis=0) == pytest.approx([25.0, 35.0], abs=1e-3)
    outside = (np.abs(angles[:, 0]) > 24.99) | (np.abs(angles[:, 1]) > 34.99)
    assert outside.mean() == pytest.approx(4 / 6, abs=0.05), "four sides and two middle lines"
