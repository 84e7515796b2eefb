"""Labels: what cannot be radians, what points nowhere, and what signs mean."""

from __future__ import annotations

import numpy as np
import pytest

from gazenerf.datasets.labels import angle_faults, check_radians, turned_degrees, unit_direction
from gazenerf.errors import UserError
from gazenerf.photographs.normalisation import label_direction, level_head


def test_degrees_are_refused_and_radians_are_not():
    check_radians(np.array([[0.5, -1.2], [np.nan, 0.1], [-1.57, 3.14]]), "labels")
    check_radians(np.zeros((0, 2)), "labels")
    with pytest.raises(UserError, match=r"a\.h5 reaches pitch 12 and yaw 30, but its labels are radians.*np\.deg2rad"):
        check_radians(np.array([[12.0, -30.0]]), "face_gaze of a.h5")


def test_vectors_without_a_length_are_faults():
    np.testing.assert_allclose(unit_direction(np.array([0.0, 0.0, -400.0])), [0, 0, -1])
    with pytest.raises(ValueError, match="no length"):
        unit_direction(np.zeros(3))
    with pytest.raises(ValueError, match="not finite"):
        unit_direction(np.array([np.inf, 0.0, 0.0]))
    assert angle_faults(np.array([[0.0, 0.1], [np.nan, 0.0]]))[0] is None
    assert "not a finite" in angle_faults(np.array([[np.nan, 0.0]]))[0]


def test_signs_in_the_picture():
    """Zero looks at the camera; a positive pitch up, which is -y; a positive yaw to the left, which is -x."""
    np.testing.assert_allclose(label_direction(0.0, 0.0), [0, 0, -1], atol=1e-12)
    assert label_direction(0.3, 0.0)[1] < -0.29 and label_direction(0.0, 0.3)[0] < -0.29
    assert label_direction(np.zeros(5), np.ones(5)).shape == (5, 3)


@pytest.mark.parametrize("seed", range(5))
def test_a_level_head_faces_where_its_pose_says(seed):
    pitch, yaw = np.random.default_rng(seed).uniform(-0.8, 0.8, 2)
    turn = level_head(pitch, yaw)
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(turn) == pytest.approx(1.0)
    np.testing.assert_allclose(turn @ [0, 0, 1], label_direction(pitch, yaw), atol=1e-12)
    assert abs((turn @ [1, 0, 0])[1]) < 1e-12 < (turn @ [1, 0, 0])[0], "its left is the picture's right, level"
    np.testing.assert_allclose(level_head(0.0, 0.0), np.diag([1.0, -1.0, -1.0]), atol=1e-12)


def test_how_far_a_head_is_turned():
    np.testing.assert_allclose(turned_degrees(np.array([0.0, 0.5]), np.array([0.7, 0.0])), np.rad2deg([0.7, 0.5]))
