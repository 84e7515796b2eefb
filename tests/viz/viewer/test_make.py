"""Keyframes and command lines: what the page writes is what the commands read."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gazenerf.cli.main import build_parser, load_command
from gazenerf.cli.parser import parsed
from gazenerf.errors import UserError
from gazenerf.geometry import Gaze
from gazenerf.geometry.cameras import NEUTRAL_FOV, Camera
from gazenerf.geometry.keyframes import read_keyframes
from gazenerf.subjects import Subject, load_subject
from gazenerf.viz.viewer.commands import Source, check_words, line, mesh_words, orbit_words, safe_name, subject_word
from gazenerf.viz.viewer.gazes import GazeChoice
from gazenerf.viz.viewer.jobs import Jobs
from gazenerf.viz.viewer.keyframes import Keyframes, keyframe
from gazenerf.viz.viewer.path_view import wxyz_of
from gazenerf.viz.viewer.people import CodeSlider, moved
from gazenerf.viz.viewer.viewpoint import Viewpoint
from tests.viz.viewer.doubles import wait_until


def options(words):
    return parsed(load_command(words[0]).Options, build_parser([words[0]]).parse_args(words))


def looking(camera: Camera) -> Viewpoint:
    wxyz = Rotation.from_matrix(camera.world_from_camera[:3, :3]).as_quat(scalar_first=True)
    return Viewpoint(tuple(wxyz), tuple(camera.position), NEUTRAL_FOV, 900, 700)


def test_kept_views_come_back_as_the_same_cameras(tmp_path):
    target = np.array([0.1, 0.2, 0.0])
    level = [Camera.orbit(yaw, 0.2, target=tuple(target)) for yaw in (-0.4, 0.5)]
    tilted = Camera.look_at(np.array([3.0, 1.0, 10.0]), up=(0.3, 1.0, 0.0))
    keys = Keyframes()
    for camera in (*level, tilted):
        keys.add(keyframe(looking(camera), target))
    file = tmp_path / "keys.json"
    file.write_text(keys.text(loop=False))
    found, loop = read_keyframes(file)
    assert not loop and [key.level for key in found] == [True, True, False]
    for key, camera in zip(found, (*level, tilted), strict=True):
        np.testing.assert_allclose(key.camera.world_from_camera, camera.world_from_camera, atol=1e-5)
        assert key.fov == pytest.approx(NEUTRAL_FOV, abs=1e-6)


def test_a_view_from_straight_above_is_kept_too(tmp_path):
    pose = np.array([[1.0, 0, 0, 0], [0, 0, -1.0, 12.0], [0, 1.0, 0, 0], [0, 0, 0, 1.0]])
    above = Camera(1.0, 1.0, 0.5, 0.5, 1, 1, pose)
    assert "world_from_camera" in keyframe(looking(above), np.zeros(3))


def test_the_path_through_kept_views_is_the_orbit_commands_and_has_frustums_like_its_cameras():
    keys = Keyframes()
    with pytest.raises(UserError, match="2 to"):
        keys.path(8)
    for yaw in (-0.4, 0.5):
        keys.add(keyframe(looking(Camera.orbit(yaw)), np.zeros(3)))
    kept, path = keys.path(8)
    assert len(kept) == 2 and len(path) == 8
    np.testing.assert_allclose(path[0].position, Camera.orbit(-0.4).position, atol=1e-5)
    np.testing.assert_allclose(path[4].position, Camera.orbit(0.5).position, atol=1e-5)
    turn = Rotation.from_quat(wxyz_of(path[4]), scalar_first=True).as_matrix()
    np.testing.assert_allclose(turn, path[4].world_from_camera[:3, :3], atol=1e-9)


def test_the_last_and_all_keys_can_be_forgotten():
    keys = Keyframes()
    keys.drop_last()
    for _ in range(3):
        keys.add({})
    keys.drop_last()
    assert len(keys) == 2
    keys.clear()
    assert len(keys) == 0


@pytest.mark.parametrize("mode", ["hold", "look-at-camera", "look-at-point", "sweep", "circle"])
def test_the_orbit_command_reads_its_words(mode):
    source = Source("small", "cpu")
    gaze = Gaze.from_degrees(-10.25, 0.0001)
    words = orbit_words(source, "ada", Path("/x/keys.json"), GazeChoice(mode), gaze, "depth", Path("/x/orbit.mp4"))
    found = options(words)
    assert (found.subject, found.checkpoint, found.device) == ("ada", Path("small"), "cpu")
    assert found.camera_path == "/x/keys.json" and found.panels == ("depth",) and found.out == Path("/x/orbit.mp4")
    if mode in ("hold", "look-at-point"):
        assert found.gaze == ((-10.25, 0.0),) and found.gaze_path is None
    else:
        assert found.gaze == () and found.gaze_path == mode


def test_mesh_and_check_read_their_words():
    gaze = Gaze.from_degrees(-3.0, 4.0)
    mesh = options(mesh_words(Source(), "ada", ("face", "eyes", "head"), gaze, Path("/x/meshes")))
    assert mesh.gaze == (-3.0, 4.0) and mesh.formats == ("glb",) and mesh.checkpoint is None
    check = options(check_words(Source(precision="float32"), "ada", gaze, Path("/x/check")))
    assert check.gaze == (-3.0, 4.0) and check.precision == "float32"


def test_what_is_shown_can_be_pasted_into_a_shell():
    assert line(["orbit", "--out", "a b.mp4"]) == "gazenerf orbit --out 'a b.mp4'"


def test_a_changed_person_becomes_a_file_and_a_bundled_one_its_name(tmp_path):
    ada = load_subject("ada")
    assert subject_word(ada, tmp_path) == "ada" and not any(tmp_path.iterdir())
    changed = moved(ada, {CodeSlider("expression", 3, "brow", 0.0, 1.0): 0.9})
    word = subject_word(changed, tmp_path)
    assert Subject.load(word).codes.expression[3] == pytest.approx(0.9)


@pytest.mark.parametrize("name", ["../../etc/passwd", "-rf", "", "a" * 500, "Zoë\n<b>"])
def test_names_from_strangers_name_files_in_the_folder_only(name):
    found = safe_name(name)
    assert 0 < len(found) <= 60 and "/" not in found and not found.startswith(("-", "."))


def test_one_command_runs_at_a_time_and_failures_are_said(tmp_path):
    ended = []
    jobs = Jobs(lambda words, code, said: ended.append((words[0], code, said)))
    assert jobs.start(["orbit", "--camera-path", "nowhere", "--out", str(tmp_path / "a.mp4")])
    assert not jobs.start(["subjects"])
    wait_until(lambda: len(ended) == 1, 60.0)
    assert ended[0][:2] == ("orbit", 2) and "nowhere" in ended[0][2] and not jobs.busy
    assert jobs.start(["subjects"])
    wait_until(lambda: len(ended) == 2, 60.0)
    assert ended[1][:2] == ("subjects", 0)


QUICK = ["--size", "32", "--speed", "guided"]


def test_a_command_says_how_far_it_is_and_ends_with_the_viewer(tmp_path):
    ended, told = [], []
    jobs = Jobs(lambda words, code, said: ended.append(code), lambda *how_far: told.append(how_far))
    jobs.start(["orbit", "--checkpoint", "small", "--frames", "5000", *QUICK, "--out", str(tmp_path / "a.mp4")])
    wait_until(lambda: len(told) > 2, 60.0)
    jobs.close()
    assert all(stage and 0 <= done <= total for stage, done, total in told)
    wait_until(lambda: bool(ended), 20.0)
    assert ended[0] not in (0, 1) and not (tmp_path / "a.mp4").exists()
