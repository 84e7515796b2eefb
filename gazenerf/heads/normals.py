"""Normals of a density: minus its gradient, by differences over a chosen scale.

Differences average the gradient over that scale whatever the sharpness of the field, where automatic
differentiation would show every grain of a trained density.
"""

from __future__ import annotations

import torch

from gazenerf.heads.march import Density

AXES = torch.tensor([[1.0, 0, 0], [0, 1, 0], [0, 0, 1], [-1, 0, 0], [0, -1, 0], [0, 0, -1]], dtype=torch.float64)
"""(6, 3) directions along the axes: central differences."""

TETRAHEDRON = torch.tensor([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], dtype=torch.float64) / 3.0**0.5
"""(4, 3) directions to the corners of a tetrahedron: a third fewer densities than central differences."""


def density_gradient(
    density: Density, points: torch.Tensor, radius: float, directions: torch.Tensor = AXES
) -> torch.Tensor:
    """(N, 3) vectors along the gradient of a density at points (N, 3), of no particular length.

    Args:
        density: What is differenced.
        points: (N, 3) world units.
        radius: World units from each point to where the density is queried.
        directions: `AXES` or `TETRAHEDRON`.
    """
    directions = directions.to(points)
    gradient = torch.zeros_like(points)
    for direction in directions:
        gradient = gradient + density(points + radius * direction)[:, None] * direction
    return gradient


def density_normals(
    density: Density, points: torch.Tensor, radius: float, directions: torch.Tensor = AXES
) -> torch.Tensor:
    """(N, 3) unit outward normals at points (N, 3); see `density_gradient`."""
    gradient = density_gradient(density, points, radius, directions)
    return -gradient / gradient.norm(dim=-1, keepdim=True).clamp(min=1e-12)
