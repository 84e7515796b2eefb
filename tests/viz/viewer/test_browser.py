"""The real server in a real browser without a window: what is seen, dragged, typed and uploaded."""

from dataclasses import replace

import numpy as np
import pytest

from gazenerf.evaluation.iris import fit_iris, opening_mask
from gazenerf.geometry import Gaze
from gazenerf.head_model import ReferenceHead
from gazenerf.image_metrics import psnr
from gazenerf.subjects import load_subject
from gazenerf.viz.viewer import make_controls, path_view
from gazenerf.viz.viewer.gaze_pad import pad_point
from gazenerf.viz.viewer.meshes import OverlayMesh
from gazenerf.viz.viewer.path_view import FRUSTUMS
from gazenerf.viz.viewer.people import subject_file
from tests.viz.viewer.doubles import wait_until
from tests.viz.viewer.tabs import HEIGHT, WIDTH, Tab

pytest.importorskip("viser", reason="viser is not installed")


@pytest.fixture(autouse=True)
def as_before(page):
    yield
    page.gaze.turn_to(Gaze())
    page.person.choose(page.person._chosen)


def test_the_picture_appears_where_it_belongs(tab):
    picture = tab.now()
    assert picture.camera.height == 256 and picture.pixels.std() > 20.0
    np.testing.assert_allclose(picture.camera.position, [0.0, 0.0, 12.0], atol=1e-3)
    wait_until(lambda: tab.looks_like(picture))


def iris_gaze(picture, eye: str) -> Gaze:
    """Where an eye of a picture looks, by its iris."""
    reference = ReferenceHead.of(load_subject("noa"))
    assert reference is not None
    mesh = reference.at(picture.gaze)
    mask = opening_mask(mesh, eye, picture.camera)
    centre = mesh.eye_centres[0 if eye == "left" else 1]
    fit = fit_iris(picture.pixels / 255.0, mask, picture.camera, centre, mesh.eye_radius)
    assert fit is not None
    return Gaze.from_vector(fit.direction)


def test_typed_angles_turn_the_irises_by_so_much(tab):
    straight = tab.now()
    turned = tab.after(lambda: tab.enter("Yaw (subject's left)", 20.0))
    assert turned.gaze.degrees == pytest.approx((0.0, 20.0))
    for eye in ("left", "right"):
        turn = np.rad2deg(iris_gaze(turned, eye).yaw - iris_gaze(straight, eye).yaw)
        assert turn == pytest.approx(20.0, abs=4.0)
    tab.enter("Yaw (subject's left)", 45.0)
    wait_until(lambda: "beyond what this field was trained on" in tab.tab.inner_text("body"))


def test_the_ball_of_the_pad_turns_the_irises_by_where_it_is_dragged(tab, page):
    straight, pad = tab.now(), page.gaze.pad
    pad.shown.value = True
    tab.after(lambda: page.gaze.turn_to(Gaze.from_degrees(0.0, -12.0)))  # so far left that the controls do not cover it
    camera = tab.now().camera.resized(WIDTH, HEIGHT)
    here, there = (camera.project(pad_point(pad._eyes, Gaze.from_degrees(*to)))[0] for to in ((0, -12), (-8, -28)))

    def dragged() -> bool:
        """Whether a drag turned the eyes; a page that has just begun may not have drawn the ball yet."""
        mouse = tab.tab.mouse
        mouse.move(*here)
        tab.tab.wait_for_timeout(400.0)  # what lies under the pointer is found a moment later
        mouse.down()
        for share in (0.3, 0.6, 1.0):
            mouse.move(*(here + share * (there - here)))
            tab.tab.wait_for_timeout(100.0)
        mouse.up()
        return page.scene.state.gaze.gaze.degrees[1] < -14.0

    wait_until(dragged, 60.0)
    wait_until(lambda: page.scene.state.gaze.gaze.degrees == pytest.approx((-8.0, -28.0), abs=1.0))
    pad.shown.value = False
    for eye in ("left", "right"):
        turn = np.rad2deg(iris_gaze(tab.now(), eye).yaw - iris_gaze(straight, eye).yaw)
        assert turn == pytest.approx(-28.0, abs=4.0)


def test_the_face_mesh_is_coloured_by_its_distance_from_the_reference(page):
    known = ReferenceHead.of(load_subject("noa")).at(Gaze())
    layers = page.layers
    layers._extracted("face", OverlayMesh(known.vertices, known.faces, np.full(len(known.vertices), 1.5)))
    assert layers._meshes["face"].visible
    layers.distances.shown.value = True
    wait_until(lambda: layers.distances._mesh.visible and not layers._meshes["face"].visible)
    assert "median 1.50 mm" in layers.distances.text.content and layers.distances.key.visible
    layers.distances.shown.value = False
    wait_until(lambda: layers._meshes["face"].visible and not layers.distances._mesh.visible)
    layers._meshes.pop("face").remove()


def test_dragging_moves_the_camera_and_the_picture_follows(tab):
    before = tab.now()
    count = len(tab.shown)

    def drag() -> None:
        mouse = tab.tab.mouse
        mouse.move(150, 300)
        mouse.down()
        for step in range(1, 9):
            mouse.move(150 + 8 * step, 300)
        mouse.up()

    tab.after(drag)
    wait_until(lambda: tab.now().camera.position[0] < -1.0)  # the head turns with the hand, the camera the other way
    after = tab.now()
    assert any(not picture.full for picture in tab.shown[count:])
    assert np.linalg.norm(after.camera.position) == pytest.approx(12.0, abs=0.05)
    wait_until(lambda: tab.looks_like(tab.now()))
    assert not tab.looks_like(before)


def test_a_slider_changes_the_face_and_reset_takes_it_back(tab):
    before = tab.now()
    tab.open("Person")
    tab.tab.get_by_text("Skin, hair and eyes", exact=True).click()
    count = len(tab.shown)
    changed = tab.after(lambda: tab.enter("skin and hair 1", 1.5))
    assert psnr(changed.pixels / 255.0, before.pixels / 255.0) < 30.0
    assert not tab.shown[count].full, "a coarse picture of the new face comes first"
    again = tab.after(lambda: tab.press("Reset the sliders"))
    assert np.array_equal(again.pixels, before.pixels)


def test_a_bad_file_gives_a_notice_and_a_good_one_another_person(tab, page, tmp_path):
    tab.now()
    tab.open("Person")
    chosen = tab.tab.locator("input[type=file]")
    (tmp_path / "noise.safetensors").write_bytes(b"\xff" * 99)
    chosen.set_input_files(tmp_path / "noise.safetensors")
    wait_until(lambda: "cannot read the subject noise.safetensors" in tab.tab.inner_text("body"))
    (tmp_path / "good.safetensors").write_bytes(subject_file(replace(load_subject("noa"), name="somebody")))
    chosen.set_input_files(tmp_path / "good.safetensors")
    wait_until(lambda: page.scene.state.subject.name == page.person.name.value == "somebody")


def test_a_path_through_kept_views_is_rendered_and_sent(tab, page, tmp_path, monkeypatch):
    words = make_controls.orbit_words
    monkeypatch.setattr(make_controls, "orbit_words", lambda *given: [*words(*given)[:-2], *QUICK, *words(*given)[-2:]])
    tab.open("Make")
    tab.press("Render this path")
    wait_until(lambda: "at least two keyframes" in tab.tab.inner_text("body"))
    for count in (1, 2):
        page._server.get_clients()[tab.number].camera.position = (3.0 * count, 0.0, 11.0)
        tab.press("Add this view as a keyframe")
        wait_until(lambda count=count: len(page.make.keys) == count)
    page.make.cameras.value = True
    wait_until(lambda: len(page.make._frustums._handles) == 2 + FRUSTUMS + 1)
    page.make.cameras.value = False
    monkeypatch.setattr(path_view, "SECONDS", 4.0)
    tab.now()  # pictures of earlier views are all shown
    count = len(tab.shown)
    tab.press("Play this path")
    wait_until(lambda: page.make.player.playing)
    wait_until(lambda: not page.make.player.playing)
    places = np.stack([picture.camera.position for picture in tab.shown[count:]])
    assert np.abs(places[:, 0] - 6.0).min() < 1.2 and tab.now().camera.position[0] == pytest.approx(3.0, abs=0.5)
    tab.press("Render this path")
    wait_until(lambda: "gazenerf orbit --subject" in tab.tab.inner_text("body"))
    wait_until(lambda: "Written" in tab.tab.inner_text("body"), 90.0)
    with tab.tab.expect_download() as download:
        tab.tab.locator("a[download='orbit.mp4']").click()
    download.value.save_as(tmp_path / "orbit.mp4")
    assert b"ftyp" in (tmp_path / "orbit.mp4").read_bytes()[:16]


QUICK = ["--frames", "2", "--size", "64"]
"""Makes the command quick without changing what it is for."""


def test_a_command_that_leaves_no_file_has_failed(page, tmp_path):
    page.make._ended(["orbit", "--out", str(tmp_path / "orbit.mp4")], 1, "ImportError: half a package")
    assert page.make.status.content == "`gazenerf orbit` failed: ImportError: half a package"


def test_two_tabs_have_their_own_cameras_and_one_head(tab, browser, page):
    own = tab.now().camera.position
    other = Tab(browser, page)
    client = page._server.get_clients()[other.number]
    other.now()
    client.camera.position = (6.0, 0.0, 10.0)
    client.camera.look_at = (0.0, 0.0, 0.0)
    tab.open("Gaze")
    tab.after(lambda: tab.enter("Pitch (up)", 10.0))
    for one in (tab, other):
        assert one.now().gaze.degrees[0] == pytest.approx(10.0)
    np.testing.assert_allclose(tab.now().camera.position, own, atol=1e-3)
    wait_until(lambda: abs(other.now().camera.position[0] - 6.0) < 1e-3)
    other.tab.close()
    wait_until(lambda: other.number not in page.visits and not other.visit.drawing)


def test_a_reloaded_tab_is_a_new_visit_and_the_old_one_ends(tab, page):
    tab.tab.reload()
    wait_until(lambda: tab.number not in page.visits and not tab.visit.drawing)
    wait_until(lambda: len(page.visits) == 1)
    (visit,) = page.visits.values()
    wait_until(lambda: visit.settled, 60.0)
