"""Teeth, gums and tongue: closed surfaces that follow the head model's codes, and the little light behind the lips."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from gazenerf.head_model.assets import faces_of, mixture_of

INNER_LIPS = range(60, 68)
"""Standard landmarks around the opening of the mouth."""

CORNERS = (60, 64)
UPPER_LIP, LOWER_LIP = (61, 62, 63), (67, 66, 65)
"""Standard landmarks: the corners of the inner lips, and what lies between on each lip, the subject's right first."""

BESIDE = 0.3
"""Share of the widest opening that counts as opening where the lips meet: light also comes in from the side."""

DEEP, CLOSED, LEAST = 0.25, 0.01, 0.08
"""What is seen of the surroundings is `opening / (opening + DEEP * depth + CLOSED)`, with the depth behind the lips, in
world units, but at least so much: some light goes through lips and cheeks."""


@dataclass(frozen=True)
class Mouth:
    """What lies behind the lips of a head model.

    Attributes:
        template: (B, 3) control vertices of the mean head.
        identity, expression: (I, B, 3) and (E, B, 3) offsets per unit of the codes.
        mix: (M, B) by which they become vertices.
        faces: (F, 3) of closed surfaces.
        albedo: (M, 3) linear RGB.
    """

    template: np.ndarray
    identity: np.ndarray
    expression: np.ndarray
    mix: sparse.csr_matrix
    faces: np.ndarray
    albedo: np.ndarray

    @classmethod
    def of(cls, data: dict[str, np.ndarray]) -> Mouth | None:
        """The mouth in the arrays of an asset; None where it has none.

        Raises:
            KeyError, ValueError, IndexError: arrays are missing or do not fit together.
        """
        if "mouth_template" not in data:
            return None
        template, albedo = data["mouth_template"].astype(np.float32), data["mouth_albedo"].astype(np.float32)
        mix, faces = mixture_of(data, "mouth", (len(albedo), len(template))), faces_of(data, "mouth", len(albedo))
        identity, expression = (data[f"mouth_{name}"].astype(np.float32) for name in ("identity", "expression"))
        for name, offsets in (("identity", identity), ("expression", expression)):
            if offsets.shape != (len(data[name]), *template.shape):
                raise ValueError(f"mouth_{name} has the shape {offsets.shape}")
        return cls(template, identity, expression, mix, faces, albedo)

    def vertices(self, identity: np.ndarray, expression: np.ndarray) -> np.ndarray:
        """(M, 3) float32 at codes (I,) and (E,), world units."""
        control = (
            self.template + np.tensordot(identity, self.identity, 1) + np.tensordot(expression, self.expression, 1)
        )
        return (self.mix @ control.astype(np.float32)).astype(np.float32)


def light_behind_lips(vertices: np.ndarray, landmarks: np.ndarray) -> np.ndarray:
    """(M,) float32 share of the surroundings that vertices (M, 3) behind the lips see.

    The wider the lips are apart, and the less far a vertex lies behind them, the more; nothing else is in the way.

    Args:
        vertices: Of teeth, gums and tongue.
        landmarks: (68, 3) the standard ones.
    """
    upper, lower = landmarks[list(UPPER_LIP)], landmarks[list(LOWER_LIP)]
    right, left = landmarks[list(CORNERS)]
    gaps = np.maximum(upper[:, 1] - lower[:, 1], 0.0)
    middle = 0.5 * (upper + lower)
    across = np.concatenate([right[:1], middle[:, 0], left[:1]])
    order = np.argsort(across)
    opening = np.interp(vertices[:, 0], across[order], np.array([0.0, *gaps, 0.0])[order])
    opening = (1.0 - BESIDE) * opening + BESIDE * gaps.max()
    ahead = max(float(middle[1, 2]), float(upper[1, 2]))
    depth = np.maximum(ahead - vertices[:, 2], 0.0)
    return np.maximum(opening / (opening + DEEP * depth + CLOSED), LEAST).astype(np.float32)
