"""The outlines of the openings of the eyes, as a subject file carries them beside its fit."""

from __future__ import annotations

import cv2
import numpy as np

from gazenerf.errors import UserError
from gazenerf.photographs.irises import lids
from gazenerf.photographs.landmarks import FaceLandmarks
from gazenerf.subjects import Subject

KEY = "eye_outlines"
"""In a subject's provenance."""


def told_outlines(landmarks: FaceLandmarks) -> dict[str, list[list[list[float]]]]:
    """What to add to a subject's provenance."""
    return {KEY: [outline.round(2).tolist() for outline in lids(landmarks)]}


def eye_outlines(subject: Subject) -> tuple[np.ndarray, np.ndarray] | None:
    """(N, 2) outlines of the openings of the left and the right eye, pixels; None where the subject has none.

    Raises:
        UserError: they are damaged.
    """
    told = subject.provenance.get(KEY)
    if told is None:
        return None
    try:
        left, right = (np.asarray(outline, dtype=np.float64) for outline in told)
        if left.shape[1] != 2 or right.shape[1] != 2 or not np.isfinite([left.sum(), right.sum()]).all():
            raise ValueError("not pixels")
    except (TypeError, ValueError, IndexError) as error:
        raise UserError("the outlines of the eyes in the subject file are damaged; fit the photograph again") from error
    return left, right


def outline_openness(outline: np.ndarray) -> float:
    """Height of an eye's opening as a share of its width."""
    (_, sides, _) = cv2.minAreaRect(outline.astype(np.float32))
    return min(sides) / max(*sides, 1e-9)
