"""Some points of a head model as differentiable functions of its codes, for fitting."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from scipy.sparse import csr_matrix

from gazenerf.head_model.lids import LID_LIMIT, LID_OPENING, LID_PITCH, LID_YAW, LOOKS, followed

ABOUT_EYES = 0.4
"""World units from an eyeball of the mean head beyond which no identity brings a vertex so near to one that its lids
have to be fitted; such vertices are linear in the codes."""


@dataclass(frozen=True)
class OtherEyeballs:
    """The eyeballs that a skin was made for, where they are not those that it gets.

    Attributes:
        centres: (2, 3) of the mean head.
        identity: (I, 2, 3) offsets per unit of identity.
        radius: World units.
    """

    centres: torch.Tensor
    identity: torch.Tensor
    radius: float


class _Linear(NamedTuple):
    """Places that are linear in the codes: (3N,), (I, 3N) and (E, 3N), flat, for N of them."""

    mean: torch.Tensor
    identity: torch.Tensor
    expression: torch.Tensor

    @staticmethod
    def of(mean: np.ndarray, identity: np.ndarray, expression: np.ndarray, mix: np.ndarray | None = None) -> _Linear:
        """Of vertices (B, 3), (I, B, 3) and (E, B, 3), or of mixtures (N, B) of them."""
        arrays = (np.asarray(array, np.float64) for array in (mean, identity, expression))
        if mix is not None:
            sparse = csr_matrix(mix)
            arrays = (_mixed(sparse, array) for array in arrays)
        flat = [torch.from_numpy(array.reshape(*array.shape[:-2], -1).copy()) for array in arrays]
        return _Linear(*flat)

    def __call__(self, identity: torch.Tensor, expression: torch.Tensor) -> torch.Tensor:
        """(N, 3) at codes (I,) and (E,)."""
        return (self.mean + identity @ self.identity + expression @ self.expression).reshape(-1, 3)


def _mixed(mix: csr_matrix, values: np.ndarray) -> np.ndarray:
    """(..., N, 3) mixtures (N, B) of values (..., B, 3)."""
    flat = np.moveaxis(values, -2, 0)
    return np.moveaxis((mix @ flat.reshape(len(flat), -1)).reshape(-1, *flat.shape[1:]), 0, -2)


class SkinPoints:
    """Points of the skin and the eyeballs' centres; agrees with `HeadModel.mesh`, in float64 and with gradients.

    Args:
        template: (B, 3) vertices that the points depend on.
        identity, expression: (I, B, 3) and (E, B, 3) offsets per unit of the codes.
        mix: (K, B) weights by which they become the points.
        names: Of the E expression coefficients.
        eyes, eyes_identity: (2, 3) and (I, 2, 3) centres of the eyeballs.
        radius, clearance: Of the eyeballs; the skin keeps that far from them.
        fitted_from: The eyeballs that the skin was made for, if it has to be fitted to these.
        upper_lids_follow: Whether the gaze drives eyeBlink and eyeWide, too, as the bundled head's.
    """

    def __init__(
        self,
        template: np.ndarray,
        identity: np.ndarray,
        expression: np.ndarray,
        mix: np.ndarray,
        names: Sequence[str],
        eyes: np.ndarray,
        eyes_identity: np.ndarray,
        radius: float,
        clearance: float,
        fitted_from: OtherEyeballs | None = None,
        upper_lids_follow: bool = False,
    ) -> None:
        away = np.linalg.norm(template[:, None] - eyes, axis=-1).min(axis=1)
        near = (mix[:, away < radius + ABOUT_EYES] != 0.0).any(axis=1)
        self._order = torch.from_numpy(np.argsort(np.concatenate([np.flatnonzero(~near), np.flatnonzero(near)])))
        self._far = _Linear.of(template, identity, expression, mix[~near])
        used = (mix[near] != 0.0).any(axis=0)
        self._base = _Linear.of(template[used], identity[:, used], expression[:, used])
        self._mix, self._eyes, self._eyes_identity = double(mix[near][:, used]), double(eyes), double(eyes_identity)
        self.radius, self._clearance, self._fitted_from = float(radius), float(clearance), fitted_from
        self._looks = [LOOKS.get(name) for name in names]
        self._followed = tuple(names) if upper_lids_follow else ()

    def eye_centres(self, identity: torch.Tensor) -> torch.Tensor:
        """(2, 3) centres of rotation, the subject's left first, world units."""
        return self._eyes + torch.tensordot(identity, self._eyes_identity, 1)

    def __call__(self, identity: torch.Tensor, expression: torch.Tensor, gaze: torch.Tensor) -> torch.Tensor:
        """(K, 3) points in world units, at codes (I,) and (E,) and a gaze (2,): pitch and yaw, radians."""
        own = followed(self._followed, expression, gaze[0]) if self._followed else expression
        driven = own + self._lids(gaze)
        base = self._base(identity, driven)
        centres = self.eye_centres(identity)
        if self._fitted_from is not None:
            old = self._fitted_from
            olds = old.centres + torch.tensordot(identity, old.identity, 1)
            for before, after in zip(olds, centres, strict=True):
                base = _fit_lids(base, before, old.radius, after, self.radius)
        points = self._mix @ base
        for centre in centres:
            offset = points - centre
            distance = offset.norm(dim=1, keepdim=True).clamp(min=1e-6)
            points = centre + offset * ((self.radius + self._clearance) / distance).clamp(min=1.0)
        return torch.cat([self._far(identity, driven), points])[self._order]

    def _lids(self, gaze: torch.Tensor) -> torch.Tensor:
        shares = gaze / double([LID_PITCH, LID_YAW])
        none = torch.zeros((), dtype=torch.float64)
        driven = [none if look is None else (look[1] * shares[look[0]]).clamp(0.0, LID_LIMIT) for look in self._looks]
        return torch.stack(driven) if driven else torch.zeros(0, dtype=torch.float64)


def double(values: object) -> torch.Tensor:
    """A float64 tensor."""
    return torch.as_tensor(np.asarray(values), dtype=torch.float64)


def _fit_lids(points: torch.Tensor, old: torch.Tensor, old_radius: float, new: torch.Tensor, radius: float):
    """`gazenerf.head_model.lids.fit_lids` in torch."""
    offset = points - old
    distance = offset.norm(dim=1, keepdim=True).clamp(min=1e-6)
    gap = distance - old_radius
    weight = 1.0 - _smoothstep(0.02, 0.16, gap)
    direction = offset / distance
    opened = direction * double(LID_OPENING)
    opened = opened / opened.norm(dim=1, keepdim=True).clamp(min=1e-6)
    direction = direction + _smoothstep(0.1, 0.5, direction[:, 2:]) * (opened - direction)
    return points + weight * (new + direction * (radius + gap) - points)


def _smoothstep(low: float, high: float, values: torch.Tensor) -> torch.Tensor:
    t = ((values - low) / (high - low)).clamp(0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


@dataclass(frozen=True)
class LinearAlbedo:
    """Albedo of some vertices, linear in the texture code before it is clipped.

    Attributes:
        mean: (K, 3) linear RGB.
        basis: (T, K, 3) added per unit of each texture code.
        lowest, highest: (K, 1) to which it is clipped.
    """

    mean: np.ndarray
    basis: np.ndarray
    lowest: np.ndarray
    highest: np.ndarray

    def at(self, texture: np.ndarray) -> np.ndarray:
        """(K, 3) linear RGB at a texture code (T,)."""
        return np.clip(self.mean + np.tensordot(texture, self.basis, 1), self.lowest, self.highest)
