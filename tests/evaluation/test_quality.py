"""The measuring itself, on a ball whose field is wrong by known amounts."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
import torch
import trimesh

from gazenerf.data.captures import Capture
from gazenerf.evaluation.quality import UNITS, Instruments, _geometry_row, evaluate_field
from gazenerf.evaluation.surface import (
    SurfaceDistance,
    depth_errors,
    every_nth,
    halved_depth,
    silhouette_iou,
    surface_points,
)
from gazenerf.geometry import Camera, Gaze
from gazenerf.head_model.interface import HeadMesh
from gazenerf.heads.interface import GeometryView, RenderedView
from gazenerf.subjects import Codes

SIZE = 48
CODES = Codes(np.zeros(2), np.zeros(2), np.zeros(2), np.zeros(27))


def _ball(camera: Camera, radius: float = 1.0) -> np.ndarray:
    """(H, W) Euclidean depth of a ball about the origin, NaN beside it."""
    origin, rays = camera.rays()
    b = (origin * rays).sum(-1)
    under = b**2 - (origin**2).sum(-1) + radius**2
    return np.where(under > 0, -b - np.sqrt(np.maximum(under, 0)), np.nan).astype(np.float32)


def _capture(person: int, view: int) -> Capture:
    camera = Camera.orbit(0.1 * view, size=SIZE)
    depth = _ball(camera)
    parts = np.isfinite(depth).astype(np.uint8)
    parts[18:24, 14:22][parts[18:24, 14:22] > 0] = 2
    image = np.full((SIZE, SIZE, 3), 128, np.uint8) * (parts > 0)[..., None].astype(np.uint8)
    return Capture(image, parts, np.nan_to_num(depth), camera, Gaze(0.1, 0.2), CODES, person, view)


class _Wrong:
    """A bound field 0.1 too bright and 0.02 world units too far forward."""

    metres_per_unit = 0.1

    def render(self, camera: Camera, parts: tuple = ("head",)) -> RenderedView:
        seen = np.isfinite(_ball(camera))
        return RenderedView(camera, {"head": (seen[..., None] * np.full(3, 128 / 255 + 0.1)).astype(np.float32)})

    def render_geometry(self, camera: Camera, part: str = "head", normals: bool = False) -> GeometryView:
        depth = _ball(camera) - np.float32(0.02)
        return GeometryView(camera, np.isfinite(depth).astype(np.float32), depth)


@pytest.fixture(scope="module")
def ball_mesh() -> HeadMesh:
    ball = trimesh.creation.icosphere(subdivisions=5)
    return HeadMesh(
        np.asarray(ball.vertices, np.float32), np.asarray(ball.faces, np.int32), np.zeros(len(ball.faces), np.uint8),
        np.asarray(ball.vertex_normals, np.float32), np.ones((len(ball.vertices), 3)), {},
        np.zeros((2, 3)), 0.1,
    )  # fmt: skip


def test_known_errors_come_out_as_they_are(ball_mesh, monkeypatch):
    wrong = SimpleNamespace(at=lambda gaze: _Wrong())
    monkeypatch.setattr("gazenerf.evaluation.quality.Head", lambda model, subject, **options: wrong)
    model = SimpleNamespace(config=SimpleNamespace(image_size=SIZE))
    head_model = SimpleNamespace(mesh=lambda codes, gaze: ball_mesh)
    off = float(np.deg2rad(4.0))

    def estimate(images: torch.Tensor, camera: Camera) -> torch.Tensor:
        bright = images.amax((1, 2, 3)) > 0.55
        return torch.stack([torch.full((len(images),), 0.1), 0.2 + off * bright.float()], dim=1)

    notes: list[str] = []
    report = evaluate_field(
        model, [_capture(person, view) for person in (0, 1) for view in (0, 1)], head_model,
        Instruments(estimate, lambda a, b: (a - b).abs().mean((1, 2, 3))),
        unseen_people={1}, iris_gazes=(), progress=lambda *step: notes.append(step),
    )  # fmt: skip
    assert [step[1:] for step in notes] == [(1, 4), (2, 4), (3, 4), (4, 4)]
    assert set(report["people"]) == {"0", "1"} and set(report["all"]) - {"captures"} <= {
        key for name in UNITS for key in (name, f"{name}_n")
    }
    for group, count in (("all", 4), ("trained", 2), ("unseen", 2)):
        values = report[group]
        assert values["captures"] == count
        assert values["psnr_head"] == pytest.approx(20.0, abs=0.01)
        assert values["psnr_eyes"] == pytest.approx(20.0, abs=0.01)
        assert values["depth_median_mm"] == pytest.approx(2.0, abs=0.15)
        assert 1.0 < values["surface_median_mm"] < 2.15
        assert values["silhouette_iou"] > 0.95
        assert values["gaze_capture_deg"] == pytest.approx(0.0, abs=1e-3)
        assert values["gaze_commanded_deg"] == pytest.approx(4.0, abs=0.05)
        assert values["gaze_difference_deg"] == pytest.approx(4.0, abs=0.05)


class _Wavy(_Wrong):
    """A ball whose depth is wrong by 0 to 0.04 world units, from place to place; counts its rays."""

    rays = 0

    def render_geometry(self, camera: Camera, part: str = "head", normals: bool = False) -> GeometryView:
        self.rays += camera.width * camera.height
        depth = _ball(camera)
        places = camera.unproject(depth)
        depth = depth - (0.02 + 0.02 * np.sin(23.0 * places[..., 0]) * np.cos(17.0 * places[..., 1])).astype(np.float32)
        return GeometryView(camera, np.isfinite(depth).astype(np.float32), depth)


def test_fewer_rays_measure_the_same(ball_mesh):
    camera = Camera.orbit(0.2, size=512)
    depth = _ball(camera)
    parts = np.isfinite(depth).astype(np.uint8)
    parts[200:232, 170:236] *= 2
    capture = Capture(np.zeros((512, 512, 3), np.uint8), parts, np.nan_to_num(depth), camera, Gaze(), CODES, 0, 0)
    head_model = SimpleNamespace(mesh=lambda codes, gaze: ball_mesh)
    few, all_rays = _Wavy(), _Wavy()
    fast = _geometry_row(few, capture, head_model)
    slow = _geometry_row(all_rays, capture, head_model, most=10_000)
    assert set(fast) == set(slow) and len(fast) == 6
    assert few.rays < 0.3 * all_rays.rays and all_rays.rays == 256**2
    assert fast.pop("depth_eyes_median_mm") == pytest.approx(slow.pop("depth_eyes_median_mm"), rel=1e-4)
    assert fast.pop("silhouette_iou") == pytest.approx(slow.pop("silhouette_iou"), abs=0.003)
    assert 0.5 < slow["depth_median_mm"] < 3.5 and fast == pytest.approx(slow, rel=0.02)


@pytest.mark.parametrize("step", [1, 2, 3])
def test_every_nth_ray_is_one_of_the_whole_cameras(step):
    camera = Camera.orbit(0.4, 0.1, size=40).cropped(3, 5, 31, 22)
    few, whole = every_nth(camera, step).rays()[1], camera.rays()[1]
    np.testing.assert_allclose(few, whole[::step, ::step], atol=1e-12)


def test_depth_is_halved_where_it_is_smooth():
    depth = np.ones((4, 4))
    depth[0, 0] = 0.0
    depth[2, 2] = 1.5
    depth[0, 2:] = 1.02
    small = halved_depth(depth)
    np.testing.assert_allclose(small, [[np.nan, 1.01], [1.0, np.nan]])
    with pytest.raises(ValueError, match="cannot be halved"):
        halved_depth(np.ones((3, 4)))


def test_mesh_distance_is_the_distance_to_the_surface(ball_mesh):
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(200, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    distance = SurfaceDistance.of_mesh(ball_mesh)
    for radius in (0.5, 0.98, 1.0, 1.01, 1.5):
        np.testing.assert_allclose(distance(radius * directions), abs(radius - 1.0), atol=0.004)


def test_surface_points_lie_on_the_ball_and_depth_agrees_with_itself():
    camera = Camera.orbit(0.3, size=SIZE)
    depth = _ball(camera)
    view = GeometryView(camera, np.isfinite(depth).astype(np.float32), depth)
    np.testing.assert_allclose(np.linalg.norm(surface_points(view), axis=1), 1.0, atol=1e-5)
    assert depth_errors(view, depth).max() == 0.0
    assert silhouette_iou(view, np.isfinite(depth)) == 1.0
    assert silhouette_iou(view, np.zeros_like(depth)) == 0.0
