import numpy as np
import pytest

from gazenerf.errors import UserError
from gazenerf.geometry import Camera, Gaze
from gazenerf.geometry import paths as P

MOVING = [name for name in P.CAMERA_PATHS if name != "still"]


def positions(cameras: list[Camera]) -> np.ndarray:
    return np.stack([camera.position for camera in cameras])


def angles(gazes: list[Gaze]) -> np.ndarray:
    return np.array([gaze.degrees for gaze in gazes])


def largest_step(points: np.ndarray) -> tuple[float, float]:
    """Largest step inside the path, and the step from the last frame back to the first."""
    return np.linalg.norm(np.diff(points, axis=0), axis=1).max(), float(np.linalg.norm(points[0] - points[-1]))


@pytest.mark.parametrize("name", P.CAMERA_PATHS)
def test_every_camera_path_looks_at_the_origin(name):
    cameras = P.camera_path(name, 17, size=(64, 48))
    assert len(cameras) == 17
    for camera in cameras:
        pixel, z = camera.project(np.zeros(3))
        np.testing.assert_allclose(pixel, [32.0, 24.0], atol=1e-9)
        assert z == pytest.approx(np.linalg.norm(camera.position))
        assert camera.world_from_camera[1, 0] == pytest.approx(0.0, abs=1e-12)  # level horizon


@pytest.mark.parametrize("name", MOVING)
def test_loops_close_without_a_pause_or_jump(name):
    inside, closing = largest_step(positions(P.camera_path(name, 60)))
    assert 0.0 < closing <= 1.01 * inside


def test_the_published_circle():
    cameras = P.circle()
    points = positions(cameras)
    assert len(cameras) == 45
    np.testing.assert_allclose(points[:, 2], 12.0)
    np.testing.assert_allclose(np.hypot(points[:, 0], points[:, 1]), 5.3)


def test_horizontal_goes_there_and_back():
    yaws = np.array([Gaze.from_vector(c.position).degrees[1] for c in P.horizontal(80, sweep=np.deg2rad(60))])
    assert yaws[0] == pytest.approx(0.0) and yaws[20] == pytest.approx(60.0) and yaws[60] == pytest.approx(-60.0)
    np.testing.assert_allclose(yaws[1:], -yaws[:0:-1], atol=1e-9)
    np.testing.assert_allclose(positions(P.horizontal(8))[:, 1], 0.0, atol=1e-12)


def test_a_full_turn_has_equal_steps_round_the_whole_head():
    points = positions(P.full_turn(36, pitch=np.deg2rad(10)))
    steps = np.linalg.norm(np.diff(np.vstack([points, points[:1]]), axis=0), axis=1)
    np.testing.assert_allclose(steps, steps[0])
    assert points[:, 2].min() < -11.0
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), 12.0)


def test_the_eight_crosses_its_middle_twice():
    points = positions(P.figure_eight(80))
    assert np.sum(np.linalg.norm(points - [0, 0, 12], axis=1) < 1e-9) == 2
    assert points[:, 1].max() == pytest.approx(-points[:, 1].min())


def test_the_dolly_reaches_both_ends_and_nothing_more():
    distance = np.linalg.norm(positions(P.dolly(40, near=7.0, far=13.0)), axis=1)
    assert distance[0] == pytest.approx(13.0) and distance[20] == pytest.approx(7.0)
    assert distance.min() >= 7.0 - 1e-9 and distance.max() <= 13.0 + 1e-9
    with pytest.raises(UserError, match="near"):
        P.dolly(4, near=5.0, far=5.0)


@pytest.mark.parametrize("frames", [0, -3, 10**11])
def test_no_frames_is_the_users_mistake(frames):
    for name in P.CAMERA_PATHS:
        with pytest.raises(UserError, match="--frames"):
            P.camera_path(name, frames)
    with pytest.raises(UserError, match="--frames"):
        P.gaze_path("hold", [])


def test_unknown_names_list_the_known():
    with pytest.raises(UserError, match="figure-eight"):
        P.camera_path("spiral", 3)
    with pytest.raises(UserError, match="look-at-camera"):
        P.gaze_path("wander", P.circle(3))


def test_a_camera_over_the_head_is_one_line():
    with pytest.raises(UserError, match="cannot place"):
        P.camera_path("full-turn", 4, pitch=np.pi / 2)


def test_look_at_camera_meets_the_camera_inside_the_range():
    eyes = np.array([0.0, 0.1, 0.9])
    cameras = P.figure_eight(24, sweep=np.deg2rad(25), pitch=np.deg2rad(12))
    for camera, gaze in zip(cameras, P.look_at_camera(cameras, eyes=eyes), strict=True):
        toward = camera.position - eyes
        np.testing.assert_allclose(gaze.vector(), toward / np.linalg.norm(toward), atol=1e-9)


def test_look_at_camera_stops_at_the_range():
    limits = P.GazeRange(np.deg2rad(20), np.deg2rad(30))
    gazes = P.look_at_camera([Camera.orbit(np.deg2rad(80), np.deg2rad(45)), Camera.orbit(np.deg2rad(-50))], limits)
    np.testing.assert_allclose(gazes[0].degrees, (20, 30))
    np.testing.assert_allclose(gazes[1].yaw, -np.deg2rad(30))
    assert all(limits.contains(gaze) for gaze in gazes)


def test_look_at_camera_has_no_jump_behind_the_head():
    gazes = angles(P.look_at_camera(P.full_turn(360, pitch=np.deg2rad(10))))
    inside, closing = largest_step(gazes)
    assert inside < 2.5 and closing < 2.5  # degrees per frame, for one degree of camera
    np.testing.assert_allclose(gazes[180], 0.0, atol=1e-6)


@pytest.mark.parametrize("name", [name for name in P.GAZE_PATHS if name != "look-at-camera"])
def test_gaze_paths_stay_in_range_and_close(name):
    limits = P.GazeRange(np.deg2rad(15), np.deg2rad(28))
    gazes = P.gaze_path(name, P.full_turn(200), limits=limits)
    assert len(gazes) == 200 and all(limits.contains(gaze) for gaze in gazes)
    inside, closing = largest_step(angles(gazes))
    assert closing <= inside + 1e-9


def test_the_sweep_is_yaw_then_pitch_to_both_ends():
    gazes = angles(P.gaze_sweep(400, P.GazeRange(np.deg2rad(20), np.deg2rad(30))))
    assert gazes[:200, 1].max() == pytest.approx(30) and gazes[:200, 1].min() == pytest.approx(-30)
    assert gazes[200:, 0].max() == pytest.approx(20) and gazes[200:, 0].min() == pytest.approx(-20)
    assert not gazes[:200, 0].any() and not gazes[200:, 1].any()


def test_targets_are_held_and_reached_without_a_jerk():
    goals = [Gaze.from_degrees(0, 0), Gaze.from_degrees(10, 30), Gaze.from_degrees(-10, -20)]
    gazes = angles(P.targets(300, goals, moving=0.4))
    for index, goal in enumerate(goals):
        np.testing.assert_allclose(gazes[100 * index : 100 * index + 60], [goal.degrees] * 60, atol=1e-9)
    acceleration = np.linalg.norm(np.diff(gazes, n=2, axis=0), axis=1)
    speed = np.linalg.norm(np.diff(gazes, axis=0), axis=1)
    assert acceleration.max() < 0.2 * speed.max()


def test_targets_that_cannot_be():
    with pytest.raises(UserError, match="at least one gaze"):
        P.targets(10, [])
    with pytest.raises(UserError, match="moving"):
        P.targets(10, [Gaze()], moving=0.0)


def test_hold_takes_the_given_gaze():
    assert P.gaze_path("hold", P.circle(3), gazes=[Gaze(0.1, 0.2)]) == [Gaze(0.1, 0.2)] * 3
