"""Positional encoding (paper Sec. 3.1)."""

from __future__ import annotations

import torch


def positional_encoding(points: torch.Tensor, frequencies: int) -> torch.Tensor:
    """Points and the sines and cosines of their octaves.

    Args:
        points: (..., 3).
        frequencies: Octaves 2^0 .. 2^(frequencies - 1).

    Returns:
        (..., 3 + 6 * frequencies) float32: x, sin(f0 x), cos(f0 x), sin(f1 x), ...
    """
    points = points.float()
    scale = 2.0 ** torch.arange(frequencies, device=points.device, dtype=points.dtype)
    angles = points[..., None, :] * scale[:, None]
    waves = torch.stack([angles.sin(), angles.cos()], dim=-2)
    return torch.cat([points, waves.flatten(-3)], dim=-1)


def spread_gains(frequencies: int, spread: float, device: torch.device | str = "cpu") -> torch.Tensor:
    """(3 + 6 * frequencies,) factors on a point's encoding that make it the mean over a Gaussian about the point.

    Octaves that turn within the Gaussian vanish (Barron et al. 2021, mip-NeRF, Eq. 14, of one deviation in every
    direction).

    Args:
        frequencies: As in `positional_encoding`.
        spread: Deviation, in the points' units.
        device: Of the factors.
    """
    scale = 2.0 ** torch.arange(frequencies, device=device, dtype=torch.float32)
    damped = torch.exp(-0.5 * (scale * spread).square()).repeat_interleave(6)
    return torch.cat([torch.ones(3, device=device), damped])
