"""What the scene holds, where the eyes look, and how large pictures are; no browser, no field."""

import numpy as np
import pytest

from gazenerf.geometry import Camera, Gaze
from gazenerf.geometry.paths import GazeRange
from gazenerf.viz.viewer.gazes import FRAMES, PERIOD, GazeChoice
from gazenerf.viz.viewer.pace import KEEPS, SMALLEST, STEP, Pace
from gazenerf.viz.viewer.scene import Scene, SceneState
from tests.viz.viewer.doubles import FlatHead

LIMITS, EYES = GazeRange(), np.array([0.0, 0.1, 0.8])


@pytest.mark.parametrize(("each_pixel", "overhead"), [(1e-6, 0.0), (3e-6, 0.03), (1e-4, 0.0), (1e-9, 0.0)])
def test_sizes_settle_where_pictures_take_at_most_the_wanted_time(each_pixel, overhead):
    pace, sizes = Pace(512, wanted=0.1), []
    for turn in range(60):
        pace.took((overhead + each_pixel * pace.size**2) * (1.0 + 0.04 * (-1) ** turn))
        sizes.append(pace.size)
    wanted = np.clip(((0.1 - overhead) / each_pixel) ** 0.5, SMALLEST, 512)
    assert wanted / (STEP * KEEPS) <= pace.size <= wanted * KEEPS
    assert len(set(sizes[20:])) == 1, "a size that changes all the time is drawn more slowly"


@pytest.mark.parametrize("largest", [32, 64, 96, 256, 512])
def test_the_largest_size_is_reached_and_the_smallest_too(largest):
    pace = Pace(largest, wanted=0.1)
    for _ in range(60):
        pace.took(1e-6)
    assert pace.size == largest == pace.size_for(0.1)
    for _ in range(60):
        pace.took(5.0)
    assert pace.size == min(SMALLEST, largest)


def test_one_slow_picture_does_not_end_a_fluent_drag():
    pace = Pace(512, wanted=0.1)
    for _ in range(30):
        pace.took(2e-6 * pace.size**2)
    before = pace.size
    pace.took(0.3)
    assert 0.7 * before < pace.size < before


def test_a_small_field_never_gets_larger_pictures_than_its_own():
    pace = Pace(96)
    pace.took(1e-9)
    assert pace.size == 96


def test_a_picture_that_may_take_longer_is_larger():
    pace = Pace(512, wanted=0.1)
    assert pace.size_for(0.5) == SMALLEST
    for _ in range(60):
        pace.took(4e-6 * pace.size**2)
    assert pace.size_for(0.4) == pytest.approx(2 * pace.size, rel=0.02)


def test_each_visitor_is_looked_at_from_where_they_are():
    choice = GazeChoice("look-at-camera")
    left, right = (choice.at(Camera.orbit(angle), 0.0, LIMITS, EYES) for angle in (0.3, -0.3))
    assert left.yaw > 0.25 and right.yaw < -0.25
    assert np.dot(left.vector(), Camera.orbit(0.3).position - EYES) == pytest.approx(
        np.linalg.norm(Camera.orbit(0.3).position - EYES), rel=1e-6
    )


def test_the_eyes_look_at_the_point_as_far_as_they_were_trained_to():
    camera = Camera.neutral()
    there = GazeChoice("look-at-point", point=(1.0, 0.6, 6.0)).at(camera, 0.0, LIMITS, EYES)
    assert there.angle_to(Gaze.from_vector(np.array([1.0, 0.5, 5.2]))) < 1e-6
    assert LIMITS.contains(GazeChoice("look-at-point", point=(9.0, 9.0, 1.0)).at(camera, 0.0, LIMITS, EYES))
    assert GazeChoice("look-at-point", point=tuple(EYES)).at(camera, 0.0, LIMITS, EYES) == Gaze()


@pytest.mark.parametrize("mode", ["sweep", "circle"])
def test_played_gazes_go_around_inside_the_range_and_return(mode):
    choice, camera = GazeChoice(mode), Camera.neutral()
    assert choice.plays
    gazes = [choice.at(camera, PERIOD * step / 40, LIMITS, EYES) for step in range(41)]
    assert all(LIMITS.contains(gaze) for gaze in gazes)
    assert (
        max(gaze.yaw for gaze in gazes) > 0.95 * LIMITS.yaw and min(gaze.pitch for gaze in gazes) < -0.9 * LIMITS.pitch
    )
    assert gazes[0].angle_to(gazes[-1]) < 4 * np.pi / FRAMES


@pytest.mark.parametrize(
    "wrong",
    [{"mode": "stare"}, {"gaze": Gaze(np.nan, 0.0)}, {"point": (0.0, np.inf, 0.0)}],
    ids=lambda one: next(iter(one)),
)
def test_impossible_gazes_are_refused(wrong):
    with pytest.raises(ValueError):
        GazeChoice(**wrong)


def test_who_listens_is_told_after_a_change_until_they_stop():
    scene, heard = Scene(SceneState(FlatHead().subject)), []
    stop = scene.listen(lambda: heard.append(scene.state.layer))
    scene.change(layer="depth")
    stop()
    scene.change(layer="image")
    assert heard == ["depth"]


def test_an_impossible_change_changes_nothing():
    scene = Scene(SceneState(FlatHead().subject))
    before = scene.state
    with pytest.raises(ValueError, match="unknown layer"):
        scene.change(layer="reference", gaze=GazeChoice("sweep"))
    assert scene.state is before
