"""Colours of lit skin as a function of texture and light codes, and how people's codes are distributed.

Albedo, linear in the texture code, times the irradiance of the light code. The two trade against each other; what
decides is how the head model's own sampler draws them.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
import torch

from gazenerf.head_model.interface import HeadModel
from gazenerf.head_model.points import double
from gazenerf.head_model.sampling import sample_person
from gazenerf.head_model.shading import LOBE, harmonic_terms

SAMPLES = 400
"""People by whom the codes' distribution is told."""

TEXTURE_SLACK, LIGHT_SLACK = 0.15, 1e-3
"""Added to deviations of texture codes and to variances of light codes."""


class LookPriors(NamedTuple):
    """How texture (T,) and light codes (27,) are distributed: mean and deviation, mean and inverse covariance."""

    texture_mean: torch.Tensor
    texture_deviation: torch.Tensor
    light_mean: torch.Tensor
    light_precision: torch.Tensor

    @staticmethod
    @lru_cache(maxsize=1)  # a fit asks eleven times
    def of(model: HeadModel) -> LookPriors:
        """By the head model's own sampler."""
        rng = np.random.default_rng(0)
        people = [sample_person(rng, model) for _ in range(SAMPLES)]
        textures, lights = (np.stack([getattr(p, name) for p in people]) for name in ("texture", "illumination"))
        precision = np.linalg.inv(np.cov(lights.T) + LIGHT_SLACK * np.eye(lights.shape[1]))
        means = double(textures.mean(axis=0)), double(lights.mean(axis=0))
        return LookPriors(means[0], double(textures.std(axis=0) + TEXTURE_SLACK), means[1], double(precision))

    def cost(self, texture: torch.Tensor, lights: torch.Tensor) -> torch.Tensor:
        """Squares of a texture code (T,) and of light codes (N, 27) in units of their deviations."""
        off = lights - self.light_mean
        squares = ((texture - self.texture_mean) / self.texture_deviation).square().sum()
        return squares + 0.5 * ((off @ self.light_precision) * off).sum()


class LitVertices(NamedTuple):
    """Vertices under a light.

    Attributes:
        mean, basis, lowest, highest: Albedo; see `gazenerf.head_model.points.LinearAlbedo`.
        open_share: (N,) of the sky that each sees.
    """

    mean: torch.Tensor
    basis: torch.Tensor
    lowest: torch.Tensor
    highest: torch.Tensor
    open_share: torch.Tensor

    @staticmethod
    def of(model: HeadModel, vertices: np.ndarray, occlusion: np.ndarray | None) -> LitVertices:
        """Of vertices (N,) of a head; `occlusion` (V,) as its mesh has it."""
        albedo = model.albedo_at(vertices)
        share = np.ones(len(vertices)) if occlusion is None else occlusion[vertices]
        return LitVertices(
            double(albedo.mean), double(albedo.basis), double(albedo.lowest), double(albedo.highest), double(share)
        )

    def colours(self, normals: torch.Tensor, texture: torch.Tensor, light: torch.Tensor) -> torch.Tensor:
        """(N, 3) sRGB from 0 to 1 at unit normals (N, 3), as `gazenerf.head_model.shading.shade` has it without
        highlights; a little beyond 1 where light does."""
        albedo = (self.mean + torch.tensordot(texture, self.basis, 1)).clamp(self.lowest, self.highest)
        sky = harmonics(normals) * double(LOBE) * self.open_share[:, None]
        linear = (albedo * (sky @ light.reshape(9, 3)).clamp(min=0.0)).clamp(1e-4, 1.5)
        return torch.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1.0 / 2.4) - 0.055)


def harmonics(directions: torch.Tensor) -> torch.Tensor:
    """`gazenerf.head_model.shading.spherical_harmonics` in torch: (N, 9) at unit directions (N, 3)."""
    x, y, z = directions.unbind(dim=-1)
    return torch.stack(harmonic_terms(x, y, z, torch.ones_like(x)), dim=-1)
