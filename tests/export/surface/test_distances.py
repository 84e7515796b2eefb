"""Surfaces of signed distances: at distance 0, and straight between grid points where densities are steps."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from gazenerf.export.options import MeshOptions
from gazenerf.export.part_mesh import extract_part
from gazenerf.export.surface.densities import sample_density
from gazenerf.export.surface.isosurface import isosurface
from gazenerf.field.model import TwoStreamField
from gazenerf.geometry import Gaze
from gazenerf.heads import Head
from gazenerf.heads.bound import BoundHead
from tests.field_doubles import make_subject, tiny_config

RADIUS, SPREAD = 0.9, 0.01
EYES = [[0.3, 0.1, 0.8, 0.15], [-0.3, 0.1, 0.8, 0.15]]
"""Centres and radii of balls that look out of the face."""


@pytest.fixture(scope="module")
def ball() -> BoundHead:
    torch.manual_seed(0)
    config = tiny_config(geometry="distance", distance_width=8, distance_frequencies=1, surface_spread=SPREAD)
    field = TwoStreamField(config).eval()
    for name, balls in (("face", [[0.0, 0.0, 0.0, RADIUS]]), ("eyes", EYES)):
        network = field.stream(name).distance
        assert network is not None
        for weights in (network.last.weight, network.move.matrix.weight):
            torch.nn.init.zeros_(weights)
        network.set_balls(np.array(balls))
    return Head(field.requires_grad_(False), make_subject(config)).at(Gaze())


@pytest.mark.parametrize("method", ["flying-edges", "lewiner"])
def test_a_coarse_grid_gives_the_ball_where_densities_give_its_steps(ball: BoundHead, method: str) -> None:
    assert ball.surface_spread == SPREAD
    grid = sample_density(ball, "face", ball.box, 32)  # cells of ten spreads
    off = {}
    for spread in (None, SPREAD):
        mesh = isosurface(grid, 0.5 / SPREAD, method, spread)
        off[spread] = np.abs(np.linalg.norm(mesh.vertices, axis=1) - RADIUS).mean()
    assert off[SPREAD] < 0.002 and off[SPREAD] < 0.2 * off[None]


def test_auto_is_the_surface_of_the_distances_and_nothing_is_smoothed(ball: BoundHead) -> None:
    found = extract_part(ball, "face", MeshOptions(resolution=48, colours=False))
    assert found.threshold is not None and (found.threshold.level, found.threshold.how) == (50.0, "distance")
    assert found.threshold.tried == () and not [step for step in found.steps if "smoothing" in step]
    from_eyes = np.min([np.linalg.norm(found.mesh.vertices - eye[:3], axis=1) for eye in EYES], axis=0)
    skin = from_eyes > 0.25
    assert skin.mean() > 0.8 and np.abs(np.linalg.norm(found.mesh.vertices[skin], axis=1) - RADIUS).max() < 0.005
    below = np.min([np.linalg.norm(found.mesh.vertices - eye[:3], axis=1) - eye[3] for eye in EYES], axis=0)
    ball_or_eye = np.minimum(
        np.abs(np.linalg.norm(found.mesh.vertices, axis=1) - RADIUS), np.abs(below - below.min())
    )  # about the eyes: the ball, or the eyeballs themselves, by one depth smaller
    assert -0.05 < below.min() < -0.008 and ball_or_eye[~skin].max() < 0.01
    smoothed = extract_part(ball, "face", MeshOptions(resolution=48, colours=False, smoothing=10))
    assert [step for step in smoothed.steps if "10 rounds" in step]
