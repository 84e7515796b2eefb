"""A subject's own parametric head: the fitted 3DMM that a field is compared with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gazenerf.geometry import Gaze
from gazenerf.head_model.interface import HeadMesh, HeadModel
from gazenerf.head_model.model import load_head_model
from gazenerf.subjects import Codes, Subject


@dataclass(frozen=True)
class ReferenceHead:
    """A parametric head with one person's parameters; the only place that looks them up.

    Attributes:
        model: The parametric head.
        codes: This person's parameters of it.
    """

    model: HeadModel
    codes: Codes

    @classmethod
    def of(cls, subject: Subject, model: HeadModel | None = None) -> ReferenceHead | None:
        """The reference head of a subject.

        Args:
            subject: Whose head.
            model: The parametric head; the bundled one by default.

        Returns:
            None where the subject carries no head-model parameters, or those of another model.
        """
        if subject.head_codes is None:
            return None
        model = load_head_model() if model is None else model
        return cls(model, subject.head_codes) if subject.head_codes.sizes == model.code_sizes else None

    def at(self, gaze: Gaze) -> HeadMesh:
        """The head as a mesh at a gaze (head frame), world frame and units; lids follow the gaze."""
        return self.model.mesh(self.codes, gaze)

    @property
    def illumination(self) -> np.ndarray:
        """(27,) spherical-harmonic light that the subject was seen in."""
        return self.codes.illumination

    def eye_midpoint(self) -> np.ndarray:
        """(3,) middle between the eyeballs' centres, world units."""
        return self.at(Gaze()).eye_centres.mean(axis=0).astype(np.float64)
