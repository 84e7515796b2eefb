"""Rays of a batch are sampled around the surfaces of a field of distances."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from gazenerf.field.config import PRESETS
from gazenerf.field.model import TwoStreamField
from gazenerf.training.batches import Batch, BatchMaker
from gazenerf.training.forward import render_batch
from gazenerf.training.surface_samples import REACH, surface_samples
from tests.training.test_forward import SIZES

HEAD, EYES = (0.0, 0.0, 0.0, 1.0), ((0.3, 0.0, 0.85, 0.2), (-0.3, 0.0, 0.85, 0.2))
HALF, COUNT = 0.024, 6


@pytest.fixture(scope="module")
def balls() -> TwoStreamField:
    """A head that is a ball, with eyes that are balls which stand out of it."""
    torch.manual_seed(0)
    field = TwoStreamField(replace(PRESETS["tiny"], geometry="distance", surface_spread=0.004, **SIZES))
    with torch.no_grad():
        for name, some in (("face", [HEAD]), ("eyes", EYES)):
            network = field.stream(name).distance
            assert network is not None
            network.last.weight.zero_()
            network.move.matrix.weight.zero_()
            network.set_balls(np.array(some))
    return field


def meets(ball: tuple[float, ...], rays_o: torch.Tensor, rays_d: torch.Tensor) -> torch.Tensor:
    """(...) distance at which rays enter a ball, NaN where they miss: the slow reference, by the quadratic equation."""
    away = rays_o - torch.tensor(ball[:3])
    along = (away * rays_d).sum(-1)
    under = along**2 - away.square().sum(-1) + ball[3] ** 2
    return torch.where(under >= 0, -along - under.clamp(min=0).sqrt(), torch.nan)


def batch_around(toy_captures, field: TwoStreamField) -> Batch:
    """A batch whose captured surface is the balls', wrong by up to 0.03 units."""
    maker = BatchMaker(toy_captures, field.config.feature_size, ray_offset=field.config.ray_offset)
    batch = maker.batch([0, 3], np.random.default_rng(0))
    every = torch.stack([meets(ball, batch.rays_o, batch.rays_d) for ball in (HEAD, *EYES)])
    first = torch.nan_to_num(every, nan=torch.inf).amin(0)
    known = torch.where(first.isfinite(), first, batch.rays_o.norm(dim=-1))
    wrong = 0.06 * torch.rand(known.shape, generator=torch.Generator().manual_seed(1)) - 0.03
    return replace(batch, distance=known + wrong)


def conditions_of(field: TwoStreamField, batch: Batch):
    label = field.label(batch.gaze)
    return {name: field.condition(name, batch.shape_code, batch.appearance_code, label) for name in field.streams}


@pytest.mark.parametrize("jitter", [False, True])
def test_samples_lie_around_the_surfaces_that_rays_meet(toy_captures, balls, jitter: bool) -> None:
    batch = batch_around(toy_captures, balls)
    t, deltas = surface_samples(balls, batch, conditions_of(balls, batch), HALF, COUNT, jitter)
    step = 2 * HALF / COUNT
    assert t.shape == (*batch.rays.shape, COUNT) and bool((t.diff(dim=-1) >= 0).all())
    assert bool(((deltas >= 0) & (deltas <= 2 * step + 1e-6)).all())
    assert bool(((t - batch.distance[..., None]).abs() <= REACH + HALF + 1e-5).all())

    face = meets(HEAD, batch.rays_o, batch.rays_d)
    steep = meets((*HEAD[:3], 0.9), batch.rays_o, batch.rays_d).isfinite() & batch.valid
    steep &= (face - batch.distance).abs() < 0.04
    off = (t - face[..., None]).abs().amin(-1)
    assert int(steep.sum()) > 50 and float(off[steep].max()) <= step
    index = batch.eye_rays[..., None]
    eyes = torch.stack([meets(ball, batch.rays_o, batch.rays_d) for ball in EYES]).nan_to_num(torch.inf).amin(0)
    near = eyes.gather(1, batch.eye_rays)
    seen = batch.eye_valid & near.isfinite() & ((near - batch.distance.gather(1, batch.eye_rays)).abs() < 0.1)
    of_eyes = (t.gather(1, index.expand(*index.shape[:2], COUNT)) - near[..., None]).abs().amin(-1)
    assert int(seen.sum()) > 5 and float(of_eyes[seen].median()) <= step


def test_a_picture_is_that_of_many_samples_through_everything(toy_captures, balls) -> None:
    batch = batch_around(toy_captures, balls)
    with torch.no_grad():
        few = render_batch(balls, batch, shell=HALF, samples=COUNT, jitter=False, geometry=False).image
        many = render_batch(balls, batch, shell=0.3, samples=400, jitter=False, geometry=False).image
    assert float(many.std()) > 0.01
    assert float((few - many).square().mean().sqrt()) < 0.1 * float(many.std())
