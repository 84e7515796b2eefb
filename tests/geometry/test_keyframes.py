import json

import numpy as np
import pytest

from gazenerf.errors import UserError
from gazenerf.geometry import Camera, Gaze
from gazenerf.geometry.keyframes import keyframe_path, read_keyframes


def keys_from(tmp_path, *keys, **more):
    path = tmp_path / "keys.json"
    path.write_text(json.dumps({"keyframes": list(keys), **more}))
    return read_keyframes(path)


def test_a_loop_passes_its_keys_and_closes(tmp_path):
    keys, loop = keys_from(tmp_path, {"yaw": 0}, {"yaw": 60, "pitch": 20, "distance": 9}, {"yaw": -50, "fov": 20})
    assert loop
    cameras = keyframe_path(keys, 90, loop=loop, size=64)
    for index, key in enumerate(keys):
        np.testing.assert_allclose(cameras[30 * index].world_from_camera, key.camera.world_from_camera, atol=1e-6)
    assert cameras[60].fx == pytest.approx(32 / np.tan(np.deg2rad(10)))
    path = np.stack([camera.position for camera in cameras])
    step = np.roll(path, -1, axis=0) - path
    bend = np.linalg.norm(np.roll(step, -1, axis=0) - step, axis=1)
    assert bend[-2:].max() <= 1.05 * bend.max() and np.linalg.norm(step[-1]) < 1.05 * np.linalg.norm(step, axis=1).max()
    distance = np.linalg.norm(path, axis=1)
    assert distance.min() > 9 - 1e-6 and distance.max() < 12 + 1e-6


def test_an_open_path_begins_and_ends_on_its_keys_along_an_arc(tmp_path):
    keys, loop = keys_from(tmp_path, {"yaw": -60}, {"yaw": 60}, loop=False)
    cameras = keyframe_path(keys, 11, loop=loop)
    yaws = [Gaze.from_vector(camera.position).degrees[1] for camera in cameras]
    np.testing.assert_allclose(yaws, np.linspace(-60, 60, 11), atol=1e-6)
    np.testing.assert_allclose([np.linalg.norm(camera.position) for camera in cameras], 12.0)


def test_a_last_key_that_repeats_the_first_is_not_shown_twice(tmp_path):
    keys, _ = keys_from(tmp_path, {"yaw": 0}, {"yaw": 120}, {"yaw": 240}, {"yaw": 360})
    yaws = np.unwrap([Gaze.from_vector(camera.position).yaw for camera in keyframe_path(keys, 36)])
    np.testing.assert_allclose(np.rad2deg(yaws), np.arange(36) * 10.0, atol=1e-5)


def test_free_poses_keep_their_roll(tmp_path):
    pose = Camera.orbit(0.3).world_from_camera.copy()
    roll = np.deg2rad(25)
    pose[:3, :3] @= np.array([[np.cos(roll), -np.sin(roll), 0], [np.sin(roll), np.cos(roll), 0], [0, 0, 1]])
    keys, _ = keys_from(tmp_path, {"world_from_camera": pose.tolist()}, {"yaw": 0}, loop=False)
    np.testing.assert_allclose(keyframe_path(keys, 5, loop=False)[0].world_from_camera, pose, atol=1e-6)


def test_positions_and_times(tmp_path):
    keys, _ = keys_from(
        tmp_path,
        {"position": [0, 0, 10], "target": [0, 0.5, 0], "time": 0},
        {"position": [3, 0, 9], "target": [0, 0.5, 0], "time": 1},
        {"position": [3, 2, 9], "target": [0, 0.5, 0], "time": 4},
        loop=False,
    )
    cameras = keyframe_path(keys, 5, loop=False)
    np.testing.assert_allclose(cameras[1].position, [3, 0, 9], atol=1e-6)
    for camera in cameras:
        np.testing.assert_allclose(camera.project(np.array([0, 0.5, 0]))[0], [128, 128], atol=1e-6)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "cannot be read as JSON"),
        ("[" * 200_000, "nested too deeply"),
        ("[1]", "2 to"),
        ('{"keyframes": 4}', "2 to"),
        ('[{"yaw": 0}, {"distance": 3}]', "keyframe 1"),
        ('[{"yaw": 0}, 7]', "keyframe 1"),
        ('[{"yaw": 0}, {"yaw": "west"}]', "keyframe 1"),
        ('[{"yaw": 0}, {"yaw": 10, "distance": -1}]', "keyframe 1"),
        ('[{"yaw": 0}, {"pitch": 90}]', "keyframe 1"),
        ('[{"yaw": 0}, {"position": [0, 0]}]', "keyframe 1"),
        ('[{"yaw": 0, "time": 1}, {"yaw": 10, "time": 1}]', "increase"),
        ('[{"yaw": NaN}, {"yaw": 10}]', "keyframe 0"),
    ],
)
def test_bad_files_are_one_line(tmp_path, text, message):
    path = tmp_path / "keys.json"
    path.write_text(text)
    with pytest.raises(UserError, match=message) as caught:
        read_keyframes(path)
    assert "\n" not in str(caught.value)


def test_missing_file_half_turn_and_no_frames(tmp_path):
    with pytest.raises(UserError, match="does not exist"):
        read_keyframes(tmp_path / "none.json")
    keys, _ = keys_from(tmp_path, {"yaw": 0}, {"yaw": 180})
    with pytest.raises(UserError, match="put one between"):
        keyframe_path(keys, 5)
    with pytest.raises(UserError, match="--frames"):
        keyframe_path(keys, 0)
    with pytest.raises(UserError, match="two"):
        keyframe_path(keys[:1], 5)
