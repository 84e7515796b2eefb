import numpy as np
import pytest

from gazenerf.geometry import Gaze
from gazenerf.geometry.gaze import rotation_x, rotation_y


def test_zero_looks_out_of_the_face():
    np.testing.assert_allclose(Gaze().vector(), [0.0, 0.0, 1.0])


def test_positive_pitch_is_up_and_positive_yaw_the_subjects_left():
    assert Gaze.from_degrees(20, 0).vector()[1] == pytest.approx(np.sin(np.deg2rad(20)))
    assert Gaze.from_degrees(0, 30).vector()[0] == pytest.approx(np.sin(np.deg2rad(30)))


@pytest.mark.parametrize("pitch", [-80, -25, 0, 10, 60])
@pytest.mark.parametrize("yaw", [-170, -35, 0, 20, 120])
def test_vector_round_trip(pitch, yaw):
    gaze = Gaze.from_degrees(pitch, yaw)
    assert np.linalg.norm(gaze.vector()) == pytest.approx(1.0)
    np.testing.assert_allclose(Gaze.from_vector(3.0 * gaze.vector()).degrees, (pitch, yaw), atol=1e-9)


def test_rotation_has_no_torsion():
    rotation = Gaze.from_degrees(15, -25).rotation()
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    assert rotation[1, 0] == pytest.approx(0.0)  # the eye's horizontal axis stays horizontal


def test_axis_rotations_are_right_handed():
    np.testing.assert_allclose(rotation_x(np.pi / 2) @ [0, 1, 0], [0, 0, 1], atol=1e-12)
    np.testing.assert_allclose(rotation_y(np.pi / 2) @ [0, 0, 1], [1, 0, 0], atol=1e-12)


def test_angles_between_gazes():
    assert Gaze.from_degrees(10, 0).angle_to(Gaze.from_degrees(-5, 0)) == pytest.approx(np.deg2rad(15))
    assert Gaze().angle_to(Gaze()) == 0.0
    assert Gaze.from_degrees(60, 0).angle_to(Gaze.from_degrees(60, 90)) < np.deg2rad(45)


def test_the_label_is_pitch_then_yaw():
    np.testing.assert_allclose(Gaze(0.1, -0.2).label, np.float32([0.1, -0.2]))


@pytest.mark.parametrize("vector", [np.zeros(3), np.array([np.nan, 0.0, 1.0])])
def test_no_direction_is_refused(vector):
    with pytest.raises(ValueError, match="gaze vector"):
        Gaze.from_vector(vector)
