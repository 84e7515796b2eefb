"""Panels and orbits of a ball with a spot that looks along the gaze: every depth is known in closed form."""

import json

import numpy as np
import pytest
import torch

from gazenerf.errors import UserError
from gazenerf.geometry import Camera, Gaze
from gazenerf.geometry.paths import circle, full_turn, hold, horizontal, look_at_camera, still
from gazenerf.heads.interface import GeometryView, RenderedView
from gazenerf.subjects import Codes, Subject
from gazenerf.viz.pictures.layout import GAP, grid_size
from gazenerf.viz.pictures.orbit import frame_size, orbit_sidecar, render_orbit, sidecar_path, write_sidecar
from gazenerf.viz.pictures.panels import PANELS, draw_panels
from gazenerf.workers import cores

RADIUS = 1.0
SUBJECT = Subject("ball", Codes(np.zeros(2), np.zeros(1), np.zeros(1), np.zeros(27)))


class Ball:
    """A bound field: a unit ball, grey, with a dark spot (the eyes) where the gaze points."""

    metres_per_unit = 0.1
    weights_hash = "ball"
    subject = SUBJECT
    box = np.array([[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]])
    background = np.ones(3)

    def __init__(self, gaze: Gaze, log: list) -> None:
        self.gaze, self.log = gaze, log

    def density(self, points, part="head"):
        return 50.0 * (points.norm(dim=-1) < RADIUS).float()

    def _trace(self, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
        rays_o, rays_d = camera.rays()
        b = (rays_o * rays_d).sum(-1)
        inside = b * b - (rays_o * rays_o).sum(-1) + RADIUS**2
        depth = np.where(inside >= 0, -b - np.sqrt(np.maximum(inside, 0)), np.nan)
        return depth, rays_o + depth[..., None] * rays_d

    def render_geometry(self, camera, part="head", normals=False):
        self.log.append(("geometry", camera.width, normals))
        depth, points = self._trace(camera)
        return GeometryView(
            camera,
            np.isfinite(depth).astype(np.float32),
            depth.astype(np.float32),
            points.astype(np.float32) if normals else None,
        )

    def render(self, camera, parts=("head",)):
        self.log.append(("render", parts))
        depth, points = self._trace(camera)
        hit = np.isfinite(depth)[..., None]
        spot = (points @ self.gaze.vector() > 0.95)[..., None]
        shades = {"face": np.where(hit, 0.6, 1.0), "eyes": np.where(spot, 0.1, 1.0)}
        shades["head"] = np.minimum(shades["face"], shades["eyes"])
        images = {part: np.repeat(shades[part], 3, axis=-1).astype(np.float32) for part in parts}
        return RenderedView(camera, images)


@pytest.fixture
def log() -> list:
    return []


class BallHead:
    """A head that logs the gazes it is bound to."""

    device = torch.device("cpu")

    def __init__(self, log: list) -> None:
        self._log = log

    def at(self, gaze: Gaze) -> Ball:
        self._log.append(("bind", gaze))
        return Ball(gaze, self._log)


@pytest.fixture
def head(log):
    return BallHead(log)


def reference(camera: Camera, gaze: Gaze) -> np.ndarray:
    return np.full((camera.height, camera.width, 3), 0.25 + gaze.yaw)


def test_panels_are_drawn_in_the_order_asked(head):
    names = ("depth", "image", "reference", "normals", "eyes", "opacity", "face")
    drawn = draw_panels(head.at(Gaze()), Camera.neutral(40), names, reference=reference)
    assert tuple(drawn) == names and set(names) == set(PANELS)
    assert all(panel.shape == (40, 40, 3) and panel.dtype == np.uint8 for panel in drawn.values())


def test_panels_show_what_they_say(head):
    drawn = draw_panels(head.at(Gaze(0, 0.1)), Camera.neutral(64), PANELS, reference=reference, geometry_size=64)
    centre, corner = (32, 32), (2, 2)
    assert drawn["face"][centre][0] == 153 and drawn["eyes"][centre][0] < 60 and drawn["image"][centre][0] < 60
    assert tuple(drawn["opacity"][centre]) == (255,) * 3 and tuple(drawn["opacity"][corner]) == (0,) * 3
    np.testing.assert_allclose(drawn["normals"][centre].astype(int), [128, 128, 255], atol=4)
    lightness = drawn["depth"].astype(float) @ [0.2126, 0.7152, 0.0722]
    assert lightness[32, 32] > lightness[32, 45] > lightness[32, 52] > lightness[corner]
    assert (drawn["reference"] == round((0.25 + 0.1) * 255)).all()


def test_only_what_is_asked_is_computed(head, log):
    draw_panels(head.at(Gaze()), Camera.neutral(256), ("face", "image"))
    draw_panels(head.at(Gaze()), Camera.neutral(256), ("depth", "opacity"))
    draw_panels(head.at(Gaze()), Camera.neutral(256), ("normals",), geometry_size=32)
    asked = [entry for entry in log if entry[0] != "bind"]
    assert asked == [("render", ("head", "face")), ("geometry", 128, False), ("geometry", 32, True)]


def test_the_fields_own_geometry_is_used_when_it_comes_with_the_picture(head, log):
    class WithGeometry(Ball):
        def render(self, camera, parts=("head",)):
            small = Ball.render_geometry(self, camera.resized(16))
            return RenderedView(camera, super().render(camera, parts).images, {"head": small})

    drawn = draw_panels(WithGeometry(Gaze(), log), Camera.neutral(64), ("image", "opacity"))
    assert [entry[0] for entry in log] == ["geometry", "render"]
    np.testing.assert_array_equal(drawn["opacity"][32, 32], [255] * 3)


def test_a_field_of_one_stream_has_no_eyes_to_show(log):
    class OneStream(Ball):
        def render(self, camera, parts=("head",)):
            return RenderedView(camera, super().render(camera, ("head",)).images)

    with pytest.raises(UserError, match="no eyes stream"):
        draw_panels(OneStream(Gaze(), log), Camera.neutral(8), ("image", "eyes"))


def test_depth_colours_do_not_flicker_along_an_orbit(head):
    cameras = full_turn(5, size=48)
    frames = list(render_orbit(head, cameras, hold(5), ("depth",), geometry_size=48))
    for frame in frames[1:]:
        assert np.abs(frame.astype(int) - frames[0]).mean() < 1.0


def test_an_orbit_has_its_frames_and_they_move(head):
    cameras = horizontal(8, size=(48, 32))
    frames = list(render_orbit(head, cameras, hold(8, Gaze(0.1, 0.0)), ("image", "eyes", "depth")))
    assert len(frames) == 8
    assert {(frame.shape[1], frame.shape[0]) for frame in frames} == {grid_size(3, 48, 32)}
    assert frame_size(cameras[0], ("image", "eyes", "depth")) == (3 * 48 + 2 * GAP, 32)
    assert np.abs(frames[0].astype(int) - frames[2]).mean() > 0.5


def test_the_spot_follows_the_camera_when_the_eyes_look_at_it(head):
    cameras = circle(6, size=64)
    gazes = look_at_camera(cameras, eyes=(0, 0, 0))
    for frame in render_orbit(head, cameras, gazes, ("eyes",)):
        rows, columns = np.nonzero(frame[..., 0] < 60)
        assert abs(rows.mean() + 0.5 - 32) < 1 and abs(columns.mean() + 0.5 - 32) < 1


def test_binding_happens_only_when_the_gaze_changes(head, log):
    gazes = [Gaze(), Gaze(), Gaze(0.1), Gaze(0.1), Gaze()]
    list(render_orbit(head, full_turn(5, size=16), gazes))
    assert [entry[1] for entry in log if entry[0] == "bind"] == [Gaze(), Gaze(0.1), Gaze()]
    assert sum(entry[0] == "render" for entry in log) == 5


def test_the_same_view_is_drawn_once(head, log):
    frames = list(render_orbit(head, still(4, Camera.neutral(16)), [Gaze(), Gaze(), Gaze(0.3), Gaze(0.3)]))
    assert sum(entry[0] == "render" for entry in log) == 2
    np.testing.assert_array_equal(frames[0], frames[1])
    assert (frames[1] != frames[2]).any()


def test_frames_are_drawn_a_few_ahead_of_the_one_taken(head, log):
    frames = render_orbit(head, full_turn(100, size=16), hold(100))
    assert not log
    next(frames)
    assert 1 <= sum(entry[0] == "render" for entry in log) <= cores() + 1


@pytest.mark.parametrize(
    ("panels", "message"),
    [
        ((), "no panels"),
        (("image", "dept"), "unknown panel 'dept'"),
        (("face", "face"), "twice"),
        (("reference",), "head"),
    ],
)
def test_panels_that_cannot_be_drawn_are_refused_before_rendering(head, log, panels, message):
    with pytest.raises(UserError, match=message):
        render_orbit(head, circle(3), hold(3), panels)
    assert not log


def test_no_frames_and_unmatched_paths(head):
    with pytest.raises(UserError, match="--frames"):
        render_orbit(head, [], [])
    with pytest.raises(ValueError, match="one gaze per camera"):
        render_orbit(head, circle(3), hold(2))
    with pytest.raises(ValueError, match="one size"):
        render_orbit(head, [Camera.neutral(8), Camera.neutral(9)], hold(2))


def test_the_sidecar_tells_every_camera_and_gaze(head, tmp_path):
    cameras, gazes = circle(4, size=32), [Gaze.from_degrees(5, -10)] * 4
    sidecar = orbit_sidecar(
        head.at(gazes[0]), cameras, gazes, panels=("image",), fps=30.0, about={"camera_path": "circle"}
    )
    path = write_sidecar(tmp_path / "o.mp4", sidecar)
    read = json.loads(path.read_text())
    assert path.name == "o.mp4.json" and read["subject"] == "ball" and read["weights"] == "ball"
    assert len(read["frames"]) == 4 and read["camera_path"] == "circle"
    assert Camera.from_dict(read["frames"][2]["camera"]).to_dict() == cameras[2].to_dict()
    assert read["frames"][1]["gaze_degrees"] == pytest.approx({"pitch": 5.0, "yaw": -10.0})


def test_sidecars_lie_with_their_video(tmp_path):
    assert sidecar_path("a/b.gif").as_posix() == "a/b.gif.json"
    assert sidecar_path("a/frames").as_posix() == "a/frames/orbit.json"
    assert sidecar_path("a/%04d.png").as_posix() == "a/orbit.json"
