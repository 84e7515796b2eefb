"""The baked path is held to the guided one, and known to fail where it must."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch

from gazenerf.checkpoints import load_field
from gazenerf.errors import UserError
from gazenerf.geometry import Camera, Gaze
from gazenerf.heads.baked import FeatureLattice, bake, draw_together
from gazenerf.heads.head import Head
from gazenerf.heads.interface import BoundField, HeadField
from gazenerf.heads.lattice import Band
from gazenerf.heads.occupancy import Occupancy
from gazenerf.image_metrics import psnr
from gazenerf.subjects import load_subject
from tests.field_doubles import make_field, make_subject, soft_field, tiny_config

TURNED = Gaze.from_degrees(15, -20)


VIEWS = [(Gaze(), 0.0), (Gaze(), 0.4), (TURNED, -0.5), (Gaze.from_degrees(-10, 25), 1.4)]
"""Gazes, among them the one of the bake, and yaws of the camera."""


@pytest.mark.parametrize("size", [(64, 64), (48, 40)])
def test_pictures_drawn_together_are_those_drawn_alone(size: tuple[int, int]) -> None:
    field = soft_field()
    head = bake(Head(field, make_subject(field.config)), Gaze())
    bounds = [head.at(gaze) for gaze, _ in VIEWS]
    near = [3.0 if i == 1 else 12.0 for i in range(len(VIEWS))]  # one reaches its borders, and its neighbours' maps
    cameras = [Camera.orbit(yaw=yaw, size=size, distance=d) for (_, yaw), d in zip(VIEWS, near, strict=True)]
    together = draw_together(bounds, cameras)
    alone = [bound.render(camera) for bound, camera in zip(bounds, cameras, strict=True)]
    for (image, geometry, _), view in zip(together, alone, strict=True):
        np.testing.assert_allclose(image, view.image, atol=1e-5)
        theirs = view.geometry["head"]
        np.testing.assert_allclose(geometry.opacity, theirs.opacity, atol=1e-6)
        np.testing.assert_allclose(geometry.depth, theirs.depth, atol=1e-5)
        assert geometry.camera.to_dict() == theirs.camera.to_dict()
    assert np.abs(together[0][0] - together[3][0]).max() > 0.05


def test_eyes_of_a_bake_are_exact_also_at_its_own_gaze() -> None:
    """Lids lie closer to eyeballs than vertices of the lattice to each other."""
    guided = Head(load_field("portrait-sdf"), load_subject("noa"))
    ours, theirs = (
        head.at(TURNED).render(Camera.orbit(0.0, size=256)).image for head in (bake(guided, TURNED), guided)
    )
    eyes = np.s_[110:140, 75:181]
    assert theirs[eyes].std() > 0.05
    assert psnr(ours[eyes], theirs[eyes]) > 50


def test_in_haste_eyes_are_interpolated_at_the_gaze_of_the_bake_alone() -> None:
    head = bake(Head(load_field("portrait-sdf"), load_subject("noa")), Gaze())
    hasty, camera = head.in_haste(), Camera.orbit(0.0, size=128)
    assert hasty.baked is head.baked and not head.hasty
    exact, quick = (one.at(Gaze()).render(camera).image for one in (head, hasty))
    eyes, rest = np.s_[55:70, 38:90], np.s_[80:]
    assert 25 < psnr(exact[eyes], quick[eyes]) < 50
    np.testing.assert_allclose(exact[rest], quick[rest], atol=1e-5)
    turned, also = (one.at(TURNED).render(camera).image for one in (head, hasty))
    np.testing.assert_array_equal(turned, also)


@pytest.mark.parametrize("yaw", [0.0, 0.6, 2.0])
def test_baked_pictures_are_the_guided_ones(yaw: float) -> None:
    field = soft_field()
    guided = Head(field, make_subject(field.config))
    head = bake(guided, Gaze())
    assert isinstance(head, HeadField) and isinstance(head.at(Gaze()), BoundField)
    assert head.report.vertices > 1000 and head.report.nbytes > 4 * head.report.vertices
    camera = Camera.orbit(yaw=yaw, size=64)
    for gaze in (Gaze(), TURNED):
        ours, theirs = head.at(gaze).render(camera), guided.at(gaze).render(camera)
        assert theirs.image.std() > 0.02
        assert psnr(ours.image, theirs.image) > 40
        small, large = ours.geometry["head"], theirs.geometry["head"]
        assert np.abs(small.opacity - large.opacity).mean() < 0.02
        assert np.nanmedian(np.abs(small.depth - large.depth)) < 0.01


def test_turning_the_eyes_asks_only_around_the_eyes(monkeypatch: pytest.MonkeyPatch) -> None:
    field = soft_field()
    exact = Head(field, make_subject(field.config))
    head = bake(exact, Gaze())
    asked: list[int] = []
    query = field.query

    def count(name: str, points: torch.Tensor, *args: object, **options: object) -> object:
        asked.append(points.shape[:-1].numel())
        return query(name, points, *args, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(field, "query", count)
    camera = Camera.neutral(64)
    head.at(Gaze()).render(camera)
    held = sum(asked)
    head.at(TURNED).render(camera)
    turned = sum(asked) - held
    exact.at(TURNED).render(camera)
    guided = sum(asked) - held - turned
    assert 0 < held < 0.5 * guided and 0 < turned < 0.5 * guided


def test_a_face_that_moves_with_the_gaze_shows_in_the_measurement() -> None:
    field = soft_field(drift=0.3)
    exact = Head(field, make_subject(field.config))
    head, camera = bake(exact, Gaze()), Camera.neutral(64)
    still = psnr(head.at(Gaze()).render(camera).image, exact.at(Gaze()).render(camera).image)
    moved = psnr(head.at(TURNED).render(camera).image, exact.at(TURNED).render(camera).image)
    assert moved < still - 6


def test_other_parts_and_densities_are_the_fields_own() -> None:
    field = soft_field()
    exact = Head(field, make_subject(field.config))
    head, camera = bake(exact, Gaze()), Camera.orbit(yaw=0.3, size=32)
    baked, bound = head.at(Gaze()), exact.at(Gaze())
    view = baked.render(camera, ("face", "head", "eyes"))
    assert list(view.images) == ["face", "head", "eyes"]
    np.testing.assert_array_equal(view.images["eyes"], bound.render(camera, ("eyes",)).images["eyes"])
    points = torch.randn(50, 3)
    assert torch.equal(baked.density(points, "face"), bound.density(points, "face"))
    np.testing.assert_array_equal(baked.render_geometry(camera).depth, bound.render_geometry(camera).depth)


def test_blending_is_the_slow_sum_over_corners() -> None:
    box = torch.tensor([[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]])
    band = Band.of(Occupancy.of(lambda points: 100.0 * (points.norm(dim=-1) < 0.6).float(), box, size=12))
    features = torch.randn(len(band.vertices), 5, generator=torch.Generator().manual_seed(0))
    lattice = FeatureLattice(band, features)
    points = 0.6 * torch.nn.functional.normalize(torch.randn(7, 3, generator=torch.Generator().manual_seed(1)), dim=-1)
    weights, counts, total = torch.rand(7) + 0.1, torch.tensor([3, 0, 4]), torch.tensor([0.9, 0.0, 0.5])
    known = {tuple(vertex): row for vertex, row in zip(band.vertices.tolist(), features, strict=True)}
    rows = []
    for first, count, whole in zip((0, 3, 3), counts.tolist(), total.tolist(), strict=True):
        value, share = torch.zeros(5), 0.0
        for point, weight in zip(points[first : first + count], weights[first : first + count], strict=True):
            place = (point + 1.0) * 12
            for corner in np.ndindex(2, 2, 2):
                vertex = place.floor() + torch.tensor(corner)
                part = float(weight * (1.0 - (place - vertex).abs()).prod())
                if (row := known.get(tuple(vertex.int().tolist()))) is not None:
                    value, share = value + part * row, share + part
        rows.append(value * whole / max(share, 1e-9))
    assert torch.allclose(lattice.blend(points, weights, counts, total), torch.stack(rows), atol=1e-5)


def test_what_has_no_surface_is_not_baked() -> None:
    config = tiny_config()
    with pytest.warns(UserWarning, match="sampled evenly"), pytest.raises(UserError, match="everywhere"):
        bake(Head(make_field(config), make_subject(config)), Gaze())
    for changes in ({"merge": "max"}, {"streams": "one"}, {"sampler": "slabs"}):
        config = tiny_config(**changes)
        with pytest.raises(UserError, match="can be baked"):
            bake(Head(make_field(config), make_subject(config)), Gaze())


def test_random_weights_are_drawn_evenly_and_loudly() -> None:
    config = tiny_config()
    field, subject = make_field(config), make_subject(config)
    camera = Camera.neutral(config.image_size)
    exact = Head(field, subject, sampler="slabs").at(Gaze()).render(camera).image
    with pytest.warns(UserWarning, match="sampled evenly"):
        guided = Head(field, subject, sampler="guided").at(Gaze()).render(camera).image
    assert np.abs(guided - exact).max() < 1e-4


def test_haze_inside_a_box_that_is_mostly_empty_is_drawn_evenly_and_loudly() -> None:
    field = soft_field()
    config = dataclasses.replace(field.config, samples=96)
    field.config = config
    for stream in field.streams.values():
        stream.density_of = lambda inside: 4.0 * (inside > 0).float()  # type: ignore[assignment]
    subject, camera = make_subject(config), Camera.neutral(32)
    with pytest.warns(UserWarning, match="holds"):
        guided = Head(field, subject, sampler="guided").at(Gaze()).render(camera).image
    exact = Head(field, subject, sampler="slabs").at(Gaze()).render(camera).image
    assert psnr(guided, exact) > 45
