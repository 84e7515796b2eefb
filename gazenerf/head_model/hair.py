"""Hair with volume: one closed surface about the skull that the hair codes raise out of the skin."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from gazenerf.head_model.assets import faces_of, mixture_of

SHOWN, FULL = -0.02, 0.1
"""Height over the bare surface, world units, at which hair begins to see its surroundings, and at which it sees all of
what its locks leave open."""

DARKEST, FURROW = 0.45, 0.25
"""Share of the surroundings that roots see, and how much less a furrow between locks sees than the top of one."""

LEAST, MOST = 0.01, 0.9
"""Albedo is clipped to these."""


def hair_code(names: Sequence[str], amounts: Mapping[str, float]) -> np.ndarray:
    """(H,) float32 hair code of amounts by name; what is not named is 0, names that a model lacks are left out."""
    return np.array([amounts.get(name, 0.0) for name in names], np.float32)


@dataclass(frozen=True)
class Hair:
    """The hair of a head model.

    Attributes:
        names: Of the H codes.
        template: (N, 3) the surface without hair on the mean head, below its skin.
        direction: (N, 3) in which each vertex is moved.
        added: (H, N) by how much per unit of each code.
        mix: (N, B) by which vertices follow the skin's B control vertices.
        faces: (F, 3) of the closed surface.
        tone: (N,) brightness of each vertex's hair over that of all hair.
        relief: (N,) -1 at the bottom of a furrow between locks, 1 on top of a lock.
        mean, basis: (3,) linear RGB, and (T, 3) added per unit of each albedo component of the texture code.
    """

    names: tuple[str, ...]
    template: np.ndarray
    direction: np.ndarray
    added: np.ndarray
    mix: sparse.csr_matrix
    faces: np.ndarray
    tone: np.ndarray
    relief: np.ndarray
    mean: np.ndarray
    basis: np.ndarray

    @classmethod
    def of(cls, data: dict[str, np.ndarray]) -> Hair | None:
        """The hair in the arrays of an asset; None where it has none.

        Raises:
            KeyError, ValueError, IndexError: arrays are missing or do not fit together.
        """
        if "hair_template" not in data:
            return None
        template = data["hair_template"].astype(np.float32)
        count, control = len(template), len(data["template"])
        faces = faces_of(data, "hair", count)
        added = data["hair_added"].astype(np.float32) * data["hair_scale"].astype(np.float32)[:, None]
        mix = mixture_of(data, "hair", (count, control))
        direction = data["hair_direction"].astype(np.float32)
        tone, relief = data["hair_tone"].astype(np.float32), data["hair_relief"].astype(np.float32) / 127.0
        mean, basis = data["hair_mean"].astype(np.float32), data["hair_basis"].astype(np.float32)
        names = tuple(str(name) for name in data["hair_names"])
        shapes = {
            "hair_added": (added.shape, (len(names), count)),
            "hair_direction": (direction.shape, (count, 3)),
            "hair_tone": (tone.shape, (count,)),
            "hair_relief": (relief.shape, (count,)),
            "hair_mean": (mean.shape, (3,)),
            "hair_basis": (basis.shape, (len(data["albedo_basis"]), 3)),
        }
        for name, (shape, wanted) in shapes.items():
            if shape != wanted:
                raise ValueError(f"{name} has the shape {shape}")
        return cls(names, template, direction, added, mix, faces, tone, relief, mean, basis)

    def vertices(self, codes: np.ndarray, moved: np.ndarray) -> np.ndarray:
        """(N, 3) float32 at hair codes (H,), world units.

        Args:
            codes: About 0 to 1 each; fewer than H where they are older than a cut, which they then lack.
            moved: (B, 3) by how much identity and expression move the skin's control vertices.
        """
        raised = self._height(codes)[:, None] * self.direction
        return (self.template + raised + self.mix @ moved.astype(np.float32)).astype(np.float32)

    def albedo(self, looks: np.ndarray) -> np.ndarray:
        """(N, 3) linear RGB at the albedo components (T,) of a texture code."""
        tint = self.mean + looks.astype(np.float32) @ self.basis
        return np.clip(self.tone[:, None] * np.maximum(tint, LEAST), LEAST, MOST).astype(np.float32)

    def light(self, codes: np.ndarray) -> np.ndarray:
        """(N,) float32 share of the surroundings that each vertex sees: roots and furrows see less."""
        height = self._height(codes)
        risen = np.clip((height - SHOWN) / (FULL - SHOWN), 0.0, 1.0)
        return ((DARKEST + (1.0 - DARKEST) * risen) * (1.0 - FURROW * 0.5 * (1.0 - self.relief))).astype(np.float32)

    def _height(self, codes: np.ndarray) -> np.ndarray:
        """(N,) by how much codes raise each vertex."""
        return codes.astype(np.float32) @ self.added[: len(codes)]
