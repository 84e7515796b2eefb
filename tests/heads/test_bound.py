from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
import torch

from gazenerf.errors import UserError
from gazenerf.field.config import FieldConfig
from gazenerf.field.model import TwoStreamField
from gazenerf.geometry import Camera, Gaze
from gazenerf.heads.bound import BoundHead
from gazenerf.heads.head import Head
from gazenerf.heads.interface import BoundField, GeometryView, Part
from gazenerf.heads.occupancy import Occupancy
from gazenerf.image_metrics import psnr
from gazenerf.subjects import Codes
from tests.field_doubles import (
    EYE_CENTRE,
    EYE_RADIUS,
    FACE_RADIUS,
    BallStream,
    make_field,
    make_subject,
    soft_field,
    tiny_config,
)

GAZE = Gaze.from_degrees(10, -15)


def bind(gaze: Gaze = GAZE, **changes: Any) -> BoundHead:
    config = tiny_config(**({"sampler": "slabs"} | changes))
    return Head(make_field(config), make_subject(config)).at(gaze)


@pytest.mark.parametrize(
    "changes",
    [
        {"merge": "max"},
        {"merge": "joint"},
        {"merge": "max", "eye_motion": "none"},
        {"streams": "one"},
        {"streams": "one", "eye_motion": "none", "gaze_input": False},
        {"merge": "max", "ray_offset": 0.0, "gaze_label_signs": (-1.0, -1.0)},
    ],
)
def test_fast_path_equals_the_published_path(changes: dict[str, Any]) -> None:
    bound = bind(**changes)
    size = bound.field.config.image_size
    camera = Camera.orbit(yaw=0.3, pitch=0.1, size=size)
    slow = bound.render_slow(camera)
    parts: tuple[Part, ...] = ("head", "face", "eyes") if bound.field.config.streams == "two" else ("head",)
    fast = bound.render(camera, parts)
    for part in parts:
        expected = slow["image" if part == "head" else f"image_{part}"][0].permute(1, 2, 0).numpy()
        assert np.abs(fast.images[part] - expected).max() < 1e-4, part
        name = f"background_alpha_{part}"
        if name in slow:
            opacity = 1.0 - slow[name].reshape(fast.geometry[part].opacity.shape).numpy()
            assert np.abs(fast.geometry[part].opacity - opacity).max() < 1e-4, part
            assert opacity.mean() > 0.02 and opacity.std() > 0


def test_is_a_bound_field() -> None:
    bound = bind()
    assert isinstance(bound, BoundField)
    assert bound.box.shape == (2, 3) and bool((bound.box[0] < bound.box[1]).all())
    assert bound.background.shape == (3,) and 0 < bound.background.min() < bound.background.max() < 1


def test_head_density_is_the_sum_and_has_gradients() -> None:
    bound = bind()
    points = torch.randn(500, 3, generator=torch.Generator().manual_seed(0)) * 0.7
    face, eyes, head = (bound.density(points, part) for part in ("face", "eyes", "head"))
    assert torch.allclose(head, face + eyes, atol=1e-5)
    assert not head.requires_grad and head.min() >= 0 and head.max() > 0
    points = points.double().float().requires_grad_(True)
    gradient = torch.autograd.grad(bound.density(points).sum(), points)[0]
    step = 1e-3 * gradient / gradient.norm(dim=1, keepdim=True).clamp(min=1e-9)
    change = bound.density(points.detach() + step) - bound.density(points.detach() - step)
    predicted = 2 * (gradient * step).sum(1)
    assert torch.corrcoef(torch.stack([change, predicted]))[0, 1] > 0.99


def test_gaze_moves_the_eyes_picture() -> None:
    config = tiny_config(sampler="slabs", gaze_input=False, merge="max")
    field, subject = make_field(config), make_subject(config)
    camera = Camera.neutral(config.image_size)
    views = [Head(field, subject).at(gaze).render(camera, ("face", "eyes")) for gaze in (Gaze(), GAZE)]
    assert np.abs(views[0].images["eyes"] - views[1].images["eyes"]).max() > 1e-3
    np.testing.assert_array_equal(views[0].images["face"], views[1].images["face"])


@pytest.mark.parametrize(("width", "height"), [(32, 32), (40, 24), (33, 21), (8, 8), (1, 1)])
def test_any_size(width: int, height: int) -> None:
    view = bind().render(Camera.neutral((width, height)))
    assert view.image.shape == (height, width, 3) and view.image.dtype == np.float32
    assert np.isfinite(view.image).all() and view.image.min() >= 0 and view.image.max() <= 1


def test_odd_size_shows_the_same_as_an_even_one() -> None:
    bound = bind()
    odd, even = bound.render(Camera.neutral(63)).image, bound.render(Camera.neutral(64)).image
    assert np.abs(odd.mean((0, 1)) - even.mean((0, 1))).max() < 0.01


def ball_distance(camera: Camera, centre: tuple[float, ...], radius: float) -> np.ndarray:
    rays_o, rays_d = camera.rays()
    towards = np.asarray(centre) - rays_o.reshape(-1, 3)
    along = (towards * rays_d.reshape(-1, 3)).sum(1)
    rest = radius**2 - (towards**2).sum(1) + along**2
    distance = np.where(rest > 0, along - np.sqrt(np.maximum(rest, 0)), np.nan)
    return distance.reshape(camera.height, camera.width)


@pytest.mark.parametrize("yaw", [0.0, 0.7, 1.571, 3.1])
@pytest.mark.parametrize("sampler", ["guided", "slabs"])
def test_known_geometry_from_every_side(balls: TwoStreamField, yaw: float, sampler: str) -> None:
    if sampler == "slabs":
        balls.config = dataclasses.replace(balls.config, samples=300)
    bound = Head(balls, make_subject(balls.config), sampler=sampler).at(Gaze())
    camera = Camera.orbit(yaw=yaw, size=24)
    face = ball_distance(camera, (0.0, 0.0, 0.0), FACE_RADIUS)
    eyes = ball_distance(camera, EYE_CENTRE, EYE_RADIUS)
    known: dict[Part, np.ndarray] = {"face": face, "eyes": eyes, "head": np.fmin(face, eyes)}
    for part, expected in known.items():
        check_geometry(bound.render_geometry(camera, part), expected)


def check_geometry(view: GeometryView, expected: np.ndarray) -> None:
    seen = np.isfinite(expected)
    assert (np.isfinite(view.depth) != seen).mean() < 0.04
    both = seen & np.isfinite(view.depth)
    assert np.median(np.abs(view.depth - expected)[both]) < 0.02
    assert view.opacity[both].mean() > 0.97 and view.opacity[~seen].mean() < 0.1


def test_normals_point_outward(balls: TwoStreamField) -> None:
    face = balls.stream("face")
    assert isinstance(face, BallStream)
    face.softness = 0.02  # wider than the differences that normals are taken over
    bound = Head(balls, make_subject(balls.config)).at(Gaze())
    camera = Camera.orbit(yaw=-0.8, size=24)
    view = bound.render_geometry(camera, "face", normals=True)
    rays_o, rays_d = camera.rays()
    at = (rays_o + view.depth[..., None] * rays_d.reshape(24, 24, 3)).reshape(-1, 3)
    assert view.normals is not None
    seen = np.isfinite(at).all(1)
    at, normals = at[seen], view.normals.reshape(-1, 3)[seen]
    cosine = (normals * at).sum(1) / np.linalg.norm(at, axis=1)
    assert seen.sum() > 100 and np.median(cosine) > 0.99


def test_guided_pictures_see_the_same_surface(balls: TwoStreamField) -> None:
    bound = Head(balls, make_subject(balls.config)).at(Gaze())
    camera = Camera.orbit(yaw=0.2, size=32)
    view = bound.render(camera)
    small = view.geometry["head"]
    expected = np.fmin(
        ball_distance(small.camera, (0.0, 0.0, 0.0), FACE_RADIUS), ball_distance(small.camera, EYE_CENTRE, EYE_RADIUS)
    )
    both = np.isfinite(expected) & np.isfinite(small.depth)
    assert both.mean() > 0.2
    assert np.median(np.abs(small.depth - expected)[both]) < 0.06


def test_slow_path_refuses_views_it_cannot_have() -> None:
    with pytest.raises(UserError, match="in front"):
        bind().render_slow(Camera.orbit(yaw=2.0, size=32))


def test_wrong_requests_are_one_line() -> None:
    config = tiny_config()
    subject = make_subject(config)
    codes = Codes(subject.codes.identity[:-1], subject.codes.expression, subject.codes.texture, np.zeros(27))
    with pytest.raises(UserError, match="identity, expression"):
        Head(make_field(config), dataclasses.replace(subject, codes=codes)).at(Gaze())
    with pytest.raises(UserError, match="NaN"):
        bind(Gaze(float("nan"), 0.0))
    with pytest.raises(UserError, match="one stream"):
        bind(streams="one").density(torch.zeros(1, 3), "face")
    with pytest.raises(UserError, match="unknown part"):
        bind().density(torch.zeros(1, 3), "nose")  # type: ignore[arg-type]


def test_bfloat16_pictures_are_close() -> None:
    config = tiny_config(sampler="slabs")
    field, subject = make_field(config), make_subject(config)
    camera = Camera.neutral(32)
    exact = Head(field, subject).at(GAZE).render(camera).image
    rough = Head(field, subject, precision="bfloat16").at(GAZE).render(camera).image
    assert 0 < np.abs(exact - rough).mean() < 0.02


def test_the_eyes_stream_is_empty_outside_its_box_on_every_path() -> None:
    box = (-0.3, -0.3, -1.0, 0.3, 0.3, 1.0)
    config = tiny_config(samples=24)
    open_field, field = make_field(config), make_field(FieldConfig.from_dict(config.to_dict() | {"eyes_box": box}))
    field.load_state_dict(open_field.state_dict())
    subject = make_subject(config)
    inside, outside = torch.tensor([[0.1, 0.2, 0.5]]), torch.tensor([[0.5, 0.0, 0.5], [0.0, -0.31, 0.0]])
    plain, boxed = (Head(item, subject, sampler="slabs").at(Gaze(0.1, 0.2)) for item in (open_field, field))
    assert float(boxed.density(inside, "eyes")) == float(plain.density(inside, "eyes")) > 0
    assert float(plain.density(outside, "eyes").min()) > 0 and float(boxed.density(outside, "eyes").max()) == 0
    assert torch.equal(boxed.density(outside), boxed.density(outside, "face"))
    camera = Camera.neutral(config.image_size)
    slow = boxed.render_slow(camera)["image"][0].permute(1, 2, 0).numpy()
    assert np.abs(boxed.render(camera).image - slow).max() < 1e-4
    assert np.abs(plain.render(camera).image - slow).max() > 1e-3
    eyes = boxed.render(camera, ("eyes",)).images["eyes"]
    assert np.allclose(eyes[0, 0], boxed.background, atol=1e-5)


def test_outlines_are_averaged_over_their_feature_pixels(balls: TwoStreamField) -> None:
    bound = Head(balls, make_subject(balls.config)).at(GAZE)
    camera = Camera.neutral(balls.config.image_size)
    opacity = bound.render(camera).geometry["head"].opacity
    partial = (opacity > 0.1) & (opacity < 0.9)
    assert partial.any(), "an outline crosses feature pixels"
    many = camera.resized(16 * opacity.shape[1])
    covered = (bound.render_geometry(many).opacity > 0.5).reshape(*(n for side in opacity.shape for n in (side, 16)))
    share = covered.mean((1, 3))
    hard = (opacity > 0.5).astype(float)
    assert np.abs(opacity - share)[partial].mean() < 0.7 * np.abs(hard - share)[partial].mean()


def test_the_sparse_path_is_its_sampler_queried_everywhere(monkeypatch: pytest.MonkeyPatch) -> None:
    """Occupancy, early termination and outline windows change nothing; an occupancy with holes does."""
    field = soft_field(feature_size=32, image_size=64)
    head = Head(field, make_subject(field.config))
    cameras = [Camera.orbit(yaw=yaw, size=64) for yaw in (0.0, 0.8)]
    sparse = [head.at(GAZE).render(camera).image for camera in cameras]
    known = head.grids
    grids = dict(known)
    monkeypatch.setattr("gazenerf.heads.render.SHELL_LEFT", -1.0)
    monkeypatch.setattr("gazenerf.heads.head.EVERYWHERE", 2.0)
    monkeypatch.setattr("gazenerf.heads.feature_map.BESIDE", (9.0, 9.0))

    def again(cells: torch.Tensor | None) -> list[np.ndarray]:
        for name, grid in grids.items():
            known[name] = Occupancy(torch.ones_like(grid.cells) if cells is None else grid.cells & cells, *_rest(grid))
        return [head.at(GAZE).render(camera).image for camera in cameras]

    for ours, theirs in zip(sparse, again(None), strict=True):
        assert psnr(ours, theirs) > 45
    holes = torch.ones(64, 64, 64, dtype=torch.bool)
    holes[::2] = False
    assert min(psnr(ours, theirs) for ours, theirs in zip(sparse, again(holes), strict=True)) < 45


def _rest(grid: Occupancy) -> tuple[torch.Tensor, torch.Tensor]:
    return grid.box, grid.density


def test_rays_stop_when_nothing_is_left_of_their_light(monkeypatch: pytest.MonkeyPatch) -> None:
    field = soft_field(samples=64)
    bound = Head(field, make_subject(field.config), sampler="slabs").at(GAZE)
    asked: list[int] = []
    query = field.query

    def count(name: str, points: torch.Tensor, *args: Any, **options: Any) -> Any:
        asked.append(points.shape[:-1].numel() if name == "face" else 0)
        return query(name, points, *args, **options)

    monkeypatch.setattr(field, "query", count)
    camera = Camera.neutral(field.config.image_size)
    fast = bound.render(camera).image
    every = field.config.feature_size**2 * 64
    assert 0.2 * every < sum(asked) < 0.95 * every
    monkeypatch.setattr("gazenerf.heads.render.EVEN_LEFT", -1.0)
    assert np.abs(bound.render(camera).image - fast).max() < 1e-5
