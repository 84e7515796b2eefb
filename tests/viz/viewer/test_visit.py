"""Visits: coarse while something moves, full when still, each in its own thread, none left behind."""

import threading

import numpy as np
import pytest

import gazenerf
from gazenerf.errors import UserError
from gazenerf.geometry import Camera, Gaze
from gazenerf.heads.baked import BakedHead
from gazenerf.heads.choose import choose_path
from gazenerf.subjects import load_subject
from gazenerf.viz.pictures.colormaps import to_uint8
from gazenerf.viz.viewer import paths as paths_module
from gazenerf.viz.viewer import visit as visit_module
from gazenerf.viz.viewer.field_facts import USUAL_SIZE
from gazenerf.viz.viewer.gazes import GazeChoice
from gazenerf.viz.viewer.paths import Paths, Unwanted
from gazenerf.viz.viewer.scene import Scene, SceneState
from gazenerf.viz.viewer.visit import LEAST_WHILE_BAKING, Picture, Visit
from tests.viz.viewer.doubles import FlatHead, wait_until
from tests.viz.viewer.test_viewpoint import viewpoint


class Watched:
    """A scene of a head with as many visits as are asked for."""

    def __init__(self, head) -> None:
        self.head, self.scene = head, Scene(SceneState(head.subject))
        self.visits: list[Visit] = []
        self.paths = Paths(head, lambda: [visit.improve() for visit in self.visits])

    def visit(self) -> tuple[Visit, list[Picture], list[str]]:
        shown, told = [], []
        self.visits.append(Visit(self.scene, self.paths, shown.append, told.append))
        return self.visits[-1], shown, told

    def close(self) -> None:
        for visit in self.visits:
            visit.close()
        self.paths.close()


@pytest.fixture
def flat():
    watched = Watched(FlatHead())
    yield watched
    watched.close()


def test_a_moved_camera_gives_a_coarse_picture_then_a_full_one_and_then_rest(flat):
    visit, shown, _ = flat.visit()
    visit.look(viewpoint())
    wait_until(lambda: bool(shown) and shown[-1].full)
    assert not shown[0].full and min(shown[0].camera.width, shown[0].camera.height) < USUAL_SIZE
    assert min(shown[-1].camera.width, shown[-1].camera.height) == USUAL_SIZE
    assert shown[-1].pixels.shape[:2] == (shown[-1].camera.height, shown[-1].camera.width)
    count = len(shown)
    visit.look(viewpoint())
    threading.Event().wait(0.5)
    assert len(shown) == count, "nothing changed, so nothing is drawn"


def test_every_change_of_the_scene_reaches_the_picture(flat):
    visit, shown, _ = flat.visit()
    visit.look(viewpoint())
    gaze = Gaze.from_degrees(5.0, -9.0)
    flat.scene.change(gaze=GazeChoice(gaze=gaze))
    wait_until(lambda: bool(shown) and shown[-1].full and shown[-1].gaze == gaze)


def test_eyes_that_play_are_drawn_without_end_and_stop_with_their_mode(flat):
    visit, shown, _ = flat.visit()
    visit.look(viewpoint())
    flat.scene.change(gaze=GazeChoice("circle"))
    wait_until(lambda: len({picture.gaze for picture in shown}) > 5)
    flat.scene.change(gaze=GazeChoice())
    wait_until(lambda: shown[-1].full)


def test_nobody_waits_for_another_visitor(flat):
    slow, shown_slow, _ = flat.visit()
    quick, shown_quick, _ = flat.visit()
    release, stuck = threading.Event(), []

    def block_one() -> None:
        if threading.current_thread() in slow._threads:
            stuck.append(True)
            release.wait(20.0)

    flat.head.before_drawing = block_one
    slow.look(viewpoint(500, 400))
    wait_until(lambda: bool(stuck))
    quick.look(viewpoint(900, 400))
    wait_until(lambda: bool(shown_quick) and shown_quick[-1].full)
    assert not shown_slow
    release.set()
    wait_until(lambda: bool(shown_slow))


@pytest.fixture
def two_cores(monkeypatch):
    monkeypatch.setattr(visit_module, "workers_for", lambda device: 2)


def test_two_pictures_of_what_moves_are_drawn_at_once_and_a_late_one_is_not_shown(two_cores, flat):
    visit, shown, _ = flat.visit()
    gates, begun = [threading.Event(), threading.Event()], []

    def wait_at_my_gate() -> None:
        number = len(begun)
        begun.append(number)
        if number < len(gates):
            gates[number].wait(20.0)

    flat.head.before_drawing = wait_at_my_gate
    visit.look(viewpoint(500, 400))
    wait_until(lambda: len(begun) == 1)
    visit.look(viewpoint(600, 400))
    wait_until(lambda: len(begun) == 2)
    visit.look(viewpoint(700, 400))
    threading.Event().wait(0.1)
    assert len(begun) == 2 and not shown, "two at once, no more"
    gates[1].set()
    wait_until(lambda: len(shown) >= 2)
    gates[0].set()
    wait_until(lambda: shown[-1].full)
    seen = [picture.camera.width / picture.camera.height for picture in shown]
    assert min(seen) > 1.35, "what was begun first shows where the camera no longer is"


def test_a_camera_that_moves_while_the_full_picture_is_drawn_is_followed_at_once(two_cores, flat):
    visit, shown, _ = flat.visit()
    gate, stuck = threading.Event(), threading.Event()

    def block_the_full_one() -> None:
        camera, _ = flat.head.drawn[-1]
        if min(camera.width, camera.height) == USUAL_SIZE and not stuck.is_set():
            stuck.set()
            gate.wait(20.0)

    flat.head.before_drawing = block_the_full_one
    visit.look(viewpoint(500, 400))
    assert stuck.wait(20.0)
    count = len(shown)
    visit.look(viewpoint(900, 400))
    wait_until(lambda: len(shown) > count)
    assert not any(picture.full for picture in shown)
    gate.set()
    wait_until(lambda: shown[-1].full)
    full = [picture.camera for picture in shown if picture.full]
    assert len(full) == 1 and full[0].width > 2 * full[0].height, "only of where the camera is"


def test_one_core_draws_one_picture_after_another(flat, monkeypatch):
    monkeypatch.setattr(visit_module, "workers_for", lambda device: 1)
    visit, shown, _ = flat.visit()
    at_once, most = [0], [0]

    def count() -> None:
        at_once[0] += 1
        most[0] = max(most[0], at_once[0])
        threading.Event().wait(0.01)
        at_once[0] -= 1

    flat.head.before_drawing = count
    for width in range(400, 800, 20):
        visit.look(viewpoint(width, 400))
        threading.Event().wait(0.005)
    wait_until(lambda: bool(shown) and shown[-1].full)
    assert most == [1]


def test_a_picture_that_cannot_be_sent_is_told_and_the_visit_goes_on(flat, capsys):
    visit, shown, told = flat.visit()
    show, failing = visit._show, threading.Event()
    failing.set()

    def send(picture: Picture) -> None:
        if failing.is_set() and picture.full:
            raise ConnectionError("gone")
        show(picture)

    visit._show = send
    visit.look(viewpoint())
    wait_until(lambda: any("gone" in line for line in told))
    assert "ConnectionError" in capsys.readouterr().err and all(thread.is_alive() for thread in visit._threads)
    failing.clear()
    visit.refresh()
    wait_until(lambda: visit.settled and shown[-1].full)


def test_a_picture_that_fails_is_told_and_the_visit_goes_on(flat, capsys):
    visit, shown, told = flat.visit()
    errors = iter([UserError("no such luck"), ZeroDivisionError("oh")])

    def fail_twice() -> None:
        if (error := next(errors, None)) is not None:
            raise error

    flat.head.before_drawing = fail_twice
    visit.look(viewpoint())
    wait_until(lambda: len(told) == 2)
    visit.look(viewpoint(300, 200))
    wait_until(lambda: bool(shown) and shown[-1].full)
    assert told[0] == "no such luck" and "oh" in told[1] and "ZeroDivisionError" in capsys.readouterr().err


def test_visits_that_end_leave_no_thread_and_no_listener():
    before = set(threading.enumerate())
    watched = Watched(FlatHead())
    for _ in range(50):
        visit, _, _ = watched.visit()
        visit.look(viewpoint())
        visit.close()
    assert watched.scene._listeners == []
    watched.close()
    assert set(threading.enumerate()) == before


@pytest.fixture(scope="module")
def small():
    watched = Watched(gazenerf.load("noa", "small"))
    wait_until(lambda: watched.paths.drawer(watched.head.subject).final, 120.0)
    yield watched
    watched.close()


@pytest.fixture(autouse=True)
def visits_end(request):
    yield
    if "small" in request.fixturenames:
        watched = request.getfixturevalue("small")
        while watched.visits:
            watched.visits.pop().close()


@pytest.mark.parametrize("layer", ["image", "eyes"])
def test_the_full_picture_is_the_heads_own(small, layer):
    gaze = Gaze.from_degrees(8.0, 12.0)
    visit, shown, _ = small.visit()
    small.scene.change(gaze=GazeChoice(gaze=gaze), layer=layer)
    visit.look(viewpoint(640, 480))
    wait_until(lambda: bool(shown) and shown[-1].full, 60.0)
    drawer = small.paths.drawer(small.scene.state.subject)
    assert isinstance(drawer.head, BakedHead)
    part = "head" if layer == "image" else layer
    expected = to_uint8(drawer.head.at(gaze).render(shown[-1].camera, (part,)).images[part])
    assert np.array_equal(shown[-1].pixels, expected)
    assert shown[-1].pixels.std() > 5.0 and shown[-1].camera.height == 256


@pytest.mark.parametrize("distance", [0.01, 0.5, -30.0, 2000.0], ids=["in the middle", "inside", "behind", "far away"])
def test_cameras_inside_and_far_from_the_head_are_drawn_too(small, distance):
    visit, shown, told = small.visit()
    visit.look(viewpoint(64, 48, position=(0.0, 0.0, distance)))
    wait_until(lambda: bool(shown) and shown[-1].full, 60.0)
    assert not told and shown[-1].camera.position[2] == distance


def test_another_person_is_drawn_evenly_at_once_and_baked_later(small):
    ben = load_subject("ben")
    small.scene.change(subject=ben, layer="image", gaze=GazeChoice())
    drawer = small.paths.drawer(ben)
    assert not drawer.final and drawer.head.subject is ben is drawer.quick.subject
    assert drawer.head.field is small.head.field
    assert drawer.quick.sampler == "slabs" and drawer.head.sampler == "guided"
    wait_until(lambda: small.paths.drawer(ben).final, 120.0)
    assert isinstance(small.paths.drawer(ben).head, BakedHead)
    small.scene.change(subject=small.head.subject)
    assert small.paths.drawer(small.head.subject).final, "the bakes of the last few people are kept"


def test_while_a_bake_is_made_what_is_still_is_drawn_large_enough_to_see(small, monkeypatch):
    release, path = threading.Event(), paths_module._path
    monkeypatch.setattr(paths_module, "_path", lambda *given: release.wait(60.0) and path(*given))
    watched = Watched(small.head)
    visit, shown, _ = watched.visit()
    visit.look(viewpoint(640, 480))
    try:
        wait_until(lambda: bool(shown) and shown[-1].camera.height >= LEAST_WHILE_BAKING, 60.0)
        assert "baking" in shown[-1].note and not shown[-1].full
        expected = to_uint8(small.head.at(Gaze()).render(shown[-1].camera).image)
        assert np.array_equal(shown[-1].pixels, expected)
    finally:
        release.set()
        watched.close()


def test_a_bake_that_is_wanted_no_more_ends_at_its_next_step(small):
    told = []

    def enough(*how_far) -> None:
        told.append(how_far)
        raise Unwanted

    with pytest.raises(Unwanted):
        choose_path(small.head, [Camera.orbit(0.0, size=32)], [Gaze()], "baked", progress=enough)
    assert len(told) == 1 and told[0][:2] == ("bake", 1) and told[0][2] > 1
    paths = Paths(small.head, lambda: None)
    wait_until(lambda: "baking" in paths.drawer(small.head.subject).note)
    paths.close()
    assert not paths._thread.is_alive() and not paths.drawer(small.head.subject).final


def test_a_head_of_one_subject_refuses_others(flat):
    with pytest.raises(UserError, match="one subject"):
        flat.paths.drawer(load_subject("ada"))
