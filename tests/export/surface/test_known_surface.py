"""Surfaces found on a lattice are those that the network is searched for, and empty space is empty."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from gazenerf.export.surface.known_surface import OCCUPIED, certainly_empty, with_known_surface
from gazenerf.geometry import Camera, Gaze
from gazenerf.heads.analytic import AnalyticField
from gazenerf.heads.bound import BoundHead
from gazenerf.heads.interface import Part
from gazenerf.image_metrics import psnr
from gazenerf.loading import load

GAZE = Gaze.from_degrees(10.0, -20.0)


@pytest.fixture(scope="module")
def bound() -> BoundHead:
    return load("mia").at(GAZE)


@pytest.mark.parametrize("part", ["face", "head"])
def test_pictures_and_depths_are_the_fields_own(bound: BoundHead, part: Part, monkeypatch) -> None:
    known, asked = with_known_surface(bound, part), []
    camera = Camera.orbit(yaw=0.5, pitch=0.1, size=256)
    query = bound.field.query

    def counted(name, points, *args, **options):
        asked.append(points.shape[:-1].numel())
        return query(name, points, *args, **options)

    known.render_geometry(camera.resized(8), part)  # makes the lattice
    monkeypatch.setattr(bound.field, "query", counted)
    ours, theirs = [], []
    for view, found in ((known, ours), (bound, theirs)):
        asked.clear()
        found += [view.render(camera, (part,)), view.render_geometry(camera.resized(96), part).depth, sum(asked)]
    solid = np.kron(ours[0].geometry[part].opacity > 0.99, np.ones((4, 4)))[:256, :256] > 0
    assert solid.mean() > 0.2
    assert psnr(ours[0].images[part], theirs[0].images[part], solid) > 38.0
    away = np.abs(ours[1] - theirs[1]) * 1000.0 * bound.metres_per_unit
    assert np.nanmedian(away) < 0.05 and np.nanpercentile(away, 95) < 0.5
    assert (np.isfinite(ours[1]) != np.isfinite(theirs[1])).mean() < 0.01
    assert ours[2] < 0.8 * theirs[2]


def test_other_parts_and_other_fields_are_left_alone(bound: BoundHead) -> None:
    analytic = AnalyticField()
    assert with_known_surface(analytic, "face") is analytic and certainly_empty(analytic, "face", 10.0) is None
    assert with_known_surface(bound, "eyes") is bound and certainly_empty(bound, "eyes", 10.0) is None
    camera, known = Camera.neutral(64), with_known_surface(bound, "face")
    assert np.array_equal(
        known.render(camera, ("eyes",)).images["eyes"], bound.render(camera, ("eyes",)).images["eyes"]
    )


@pytest.mark.parametrize("part", ["face", "head"])
def test_empty_points_have_no_density(bound: BoundHead, part: Part) -> None:
    empty = certainly_empty(bound, part, OCCUPIED)
    assert empty is not None and certainly_empty(bound, part, 0.9 * OCCUPIED) is None
    points = np.random.default_rng(0).uniform(*bound.box, (60_000, 3))
    nothing = empty(points)
    assert 0.5 < nothing.mean() < 0.95
    density = bound.density(torch.from_numpy(points.astype(np.float32)), part).numpy()
    assert density[nothing].max() < OCCUPIED < 10.0 < density[~nothing].max()
