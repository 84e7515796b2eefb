"""Volume rendering weights, of one medium and of two in the same place."""

from __future__ import annotations

import torch

EPSILON = 1e-10


def transmittance(alpha: torch.Tensor) -> torch.Tensor:
    """(..., S) share of light that reaches each sample, as published: products of 1 - alpha + 1e-10."""
    passed = torch.cumprod(1.0 - alpha + EPSILON, dim=-1)
    return torch.cat([torch.ones_like(passed[..., :1]), passed[..., :-1]], dim=-1)


def composite(density: torch.Tensor, deltas: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Weights of the samples of rays through one medium.

    Args:
        density: (..., S) per world unit.
        deltas: (..., S) interval lengths, world units.

    Returns:
        weights (..., S) and opacity (...), their sum.
    """
    alpha = 1.0 - torch.exp(-density * deltas)
    weights = transmittance(alpha) * alpha
    return weights, weights.sum(-1)


def composite_joint(
    density_face: torch.Tensor, density_eyes: torch.Tensor, deltas: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Weights of the samples of rays through face and eyes as one medium (this project's merge).

    The density is the sum; each sample's weight is shared between the streams by density. The
    nearer surface therefore hides the farther one, whichever stream it belongs to.

    Args:
        density_face, density_eyes: (..., S) at the same samples.
        deltas: (..., S).

    Returns:
        weights_face (..., S), weights_eyes (..., S), opacity (...).
    """
    total = density_face + density_eyes
    weights, opacity = composite(total, deltas)
    share = density_eyes / total.clamp(min=EPSILON)
    return weights * (1.0 - share), weights * share, opacity
