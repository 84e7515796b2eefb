"""Outlines are lines, and what is thin is not a hole."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import nn

from gazenerf.field.streams import StreamCondition
from gazenerf.geometry import Camera, Gaze
from gazenerf.heads.baked import bake
from gazenerf.heads.feature_map import FeatureGrid, RayFeatures, cut_out
from gazenerf.heads.head import Head
from gazenerf.heads.render import composite_rays
from tests.field_doubles import SoftStream, make_field, make_subject, tiny_config

SIDE = 32


def disc(size: int, radius: float) -> torch.Tensor:
    """(size, size) 1 at the pixels whose centre lies in a disc; the radius is a share of the side."""
    place = (torch.arange(size) + 0.5) / size - 0.5
    return (torch.hypot(place[:, None], place[None]) < radius).float()


def roughness(picture: torch.Tensor) -> float:
    """Standard deviation, picture pixels, of where rays from the middle leave a bright disc."""
    size = picture.shape[-1]
    along = np.arange(0.1 * size, 0.5 * size - 1, 0.05)
    found = []
    for angle in np.linspace(0.0, 2.0 * np.pi, 360, endpoint=False):
        x, y = (size / 2 - 0.5 + along * f(angle) for f in (np.cos, np.sin))
        column, row = np.floor(x).astype(int), np.floor(y).astype(int)
        a, b = x - column, y - row
        p = picture.numpy()
        value = (
            (1 - a) * (1 - b) * p[row, column] + a * (1 - b) * p[row, column + 1]
            + (1 - a) * b * p[row + 1, column] + a * b * p[row + 1, column + 1]
        )  # fmt: skip
        found.append(along[np.argmax(value < 0.5)])
    return float(np.std(found))


@pytest.mark.parametrize("k", [2, 4, 8])
def test_the_contour_of_a_matte_is_a_circle(k: int) -> None:
    matte = disc(2 * SIDE, 0.31)
    size = k * SIDE
    cut = cut_out(torch.ones(3, size, size), torch.zeros(3, size, size), matte)[0]
    stairs = torch.nn.functional.interpolate(matte[None, None], size=(size, size))[0, 0]
    assert roughness(cut) < 0.11 * k < roughness(stairs)
    assert float(cut[size // 2, size // 2]) == 1.0 and float(cut[0, 0]) == 0.0
    edge = ((cut > 0.05) & (cut < 0.95)).sum() / (2 * np.pi * 0.31 * size)
    assert edge < 0.75 * k  # picture pixels across


def test_features_go_on_beyond_an_outline_and_the_matte_ends_them() -> None:
    grid = FeatureGrid.of(Camera.neutral(4 * SIDE), tiny_config(feature_size=SIDE, image_size=4 * SIDE))
    inside = disc(SIDE, 0.3).flatten()
    background = torch.full((SIDE * SIDE, 3), -1.0)
    features = torch.where(inside[:, None] > 0, 5.0, background)
    found = RayFeatures(features, inside.clone(), torch.where(inside > 0, 12.0, torch.nan))

    def composite(rays_o: torch.Tensor, rays_d: torch.Tensor, behind: torch.Tensor, *_: object) -> RayFeatures:
        x, y = (-rays_d[:, i] / rays_d[:, 2] * rays_o[:, 2] for i in (0, 1))
        extent = 2 * 12.0 * np.tan(np.deg2rad(14.2) / 2)
        alpha = (torch.hypot(x, y) < 0.3 * extent).float()
        return RayFeatures(torch.where(alpha[:, None] > 0, 5.0, behind), alpha, torch.full_like(alpha, 12.0))

    seen = grid.smooth_outline(composite, background, found, cut=True)
    assert seen.matte is not None and set(seen.matte.unique().tolist()) == {0.0, 1.0}
    assert torch.equal(seen.matte, disc(2 * SIDE, 0.3))
    near = torch.nn.functional.max_pool2d(inside.reshape(1, 1, SIDE, SIDE), 3, stride=1, padding=1).flatten() > 0
    assert torch.allclose(seen.features[near], torch.tensor(5.0))  # also just outside
    far = disc(SIDE, 0.5).flatten() == 0
    assert torch.equal(seen.features[far], background[far])
    assert 0.0 < float(seen.opacity.frac().max()) < 1.0  # the opacity itself is an average


class Veiled(SoftStream):
    """A ball behind a veil that takes half the light."""

    def query(
        self, points: torch.Tensor, condition: StreamCondition, features: bool = True
    ) -> tuple[torch.Tensor, torch.Tensor]:
        density, hidden = super().query(points, condition, features)
        veil = 14.0 * torch.sigmoid((0.025 - (points[..., 2] - 1.35).abs()) / 0.002)
        return density + veil * (points[..., :2].norm(dim=-1) < 0.3), hidden


def test_what_lies_behind_a_thin_surface_is_seen_through_it() -> None:
    config = tiny_config(eyes_box=None)
    field = make_field(config)
    field.streams = nn.ModuleDict(
        {"face": Veiled(config, (0.0, 0.0, 0.0), 1.0), "eyes": SoftStream(config, (0.0, -0.9, 0.2), 0.05)}
    )
    head = Head(field.eval().requires_grad_(False), make_subject(config))
    bound, camera = head.at(Gaze()), Camera.neutral(64)
    grid = FeatureGrid.of(camera, config)
    middle = (grid.shape[0] // 2) * grid.shape[1] + grid.shape[1] // 2
    with head.quickly():
        background = field.renderer.background(*grid.shape)[0].flatten(1).T.float()
        alone = composite_rays(bound, grid.rays_o, grid.rays_d, ("face", "eyes"), background)
    assert 0.3 < float(alone.opacity[middle]) < 0.8  # the veil alone is no head
    for view in (bound.render(camera), bake(head, Gaze()).at(Gaze()).render(camera)):
        assert view.geometry["head"].opacity.reshape(-1)[middle] > 0.97
