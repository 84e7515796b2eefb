"""Normals of a density are those of its gradient."""

from __future__ import annotations

import numpy as np
import torch

from gazenerf.export.surface.normals import surface_normals
from gazenerf.heads.analytic import AnalyticField


def test_normals_are_minus_the_gradient_that_automatic_differentiation_finds():
    bound = AnalyticField(sharpness=0.2)
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(300, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    points = bound.face.centre + directions * bound.face.radii
    leaves = torch.from_numpy(points).float().requires_grad_()
    bound.density(leaves, "face").sum().backward()
    assert leaves.grad is not None
    exact = -leaves.grad.numpy().astype(np.float64)
    exact /= np.linalg.norm(exact, axis=1, keepdims=True)
    found = surface_normals(bound, points, "face", 0.005, directions)
    assert np.rad2deg(np.arccos(np.clip((found * exact).sum(1), -1, 1))).max() < 1.0
    assert np.allclose(np.linalg.norm(found, axis=1), 1.0)


def test_flat_and_contrary_densities_fall_back():
    bound = AnalyticField(sharpness=0.2)
    far, up = np.array([[5.0, 5.0, 5.0]]), np.array([[0.0, 1.0, 0.0]])
    assert np.array_equal(surface_normals(bound, far, "face", 0.005, up), up)
    top = bound.face.centre + np.array([[0.0, bound.face.radii[1], 0.0]])
    assert np.array_equal(surface_normals(bound, top, "face", 0.005, -up), -up)
