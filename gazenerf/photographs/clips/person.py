"""Who is seen in a video: what all its frames share, fitted to several of them at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gazenerf.errors import UserError
from gazenerf.head_model.interface import HeadModel
from gazenerf.photographs.fit import Photograph, fit_photographs
from gazenerf.photographs.irises import openness
from gazenerf.photographs.landmarks import FaceLandmarks
from gazenerf.photographs.redirect import Redirector
from gazenerf.subjects import Subject

CLOSED_SHARE = 0.45
"""Eyes that are open by less than this share of what they are in most frames count as closed."""

WIDE = 0.8
"""Quantile of the openness over a clip that stands for open eyes."""

OFFSETS, FOCAL = "eye_offsets", "focal_px"
"""Keys of the provenance of a clip's subject."""


@dataclass(frozen=True)
class Person:
    """What the frames of a clip share.

    Attributes:
        subject: Identity, texture, and the camera, light, gaze and expression of the first chosen frame.
        focal: Pixels.
        eye_offsets: (2, 3) world units from the head model's eyeballs to those that the pictures show, left first.
    """

    subject: Subject
    focal: float
    eye_offsets: np.ndarray

    def save(self, path: Path) -> None:
        """Write it as a subject file."""
        about = self.subject.provenance | {OFFSETS: self.eye_offsets.tolist(), FOCAL: self.focal}
        replace(self.subject, provenance=about).save(path)

    @classmethod
    def load(cls, path: Path) -> Person:
        """Read what `save` wrote.

        Raises:
            UserError: damaged.
        """
        subject = Subject.load(path)
        try:
            offsets = np.asarray(subject.provenance[OFFSETS], dtype=np.float64).reshape(2, 3)
            return cls(subject, float(subject.provenance[FOCAL]), offsets)
        except (KeyError, TypeError, ValueError) as error:
            raise UserError(f"{path} is damaged; add --overwrite to begin anew") from error


def shut(points: np.ndarray) -> np.ndarray:
    """(T,) bool: frames in which both eyes are closed, by landmarks (T, 478, 2); False where there is no face."""
    wide = np.full(len(points), np.nan)
    for number in np.flatnonzero(np.isfinite(points).all(axis=(1, 2))):
        wide[number] = max(openness(FaceLandmarks(points[number])))
    if np.isnan(wide).all():
        return np.zeros(len(points), bool)
    return np.nan_to_num(wide, nan=np.inf) < CLOSED_SHARE * np.nanquantile(wide, WIDE)


def chosen_frames(points: np.ndarray, count: int) -> list[int]:
    """Numbers of frames that show the person well: of each part of a clip the one with the widest eyes.

    Args:
        points: (T, 478, 2) landmarks, NaN where there is no face.
        count: At most so many.
    """
    seen = np.flatnonzero(np.isfinite(points).all(axis=(1, 2)))
    parts = np.array_split(seen, min(count, len(seen))) if len(seen) else []
    return [int(max(part, key=lambda number: min(openness(FaceLandmarks(points[number]))))) for part in parts]


def fit_person(
    frames: Sequence[np.ndarray], points: np.ndarray, name: str, model: HeadModel, focal: float | None = None,
    table: Path | None = None,
) -> Person:  # fmt: skip
    """Fit one person to frames of one clip, all of one focal length.

    Args:
        frames: (H, W, 3) uint8.
        points: (F, 478, 2) their landmarks.
        name: Of the clip.
        model: The head model.
        focal: Pixels, where it is known.
        table: Landmark table of the head model; see `table_for`.

    Raises:
        UserError: the face is too small, seen in profile, or shows no iris in any of them.
    """
    photographs = [
        Photograph(f"{name}, frame {number + 1} of those it is fitted to", frame, FaceLandmarks(marks), focal=focal)
        for number, (frame, marks) in enumerate(zip(frames, points.astype(np.float64), strict=True))
    ]
    fitted = fit_photographs(photographs, model, table, one_camera=True)
    offsets, why = [], ""
    for photograph, item in zip(photographs, fitted, strict=True):
        try:
            offsets.append(Redirector(photograph.pixels, item.subject, model).eye_offsets())
        except UserError as error:
            why = str(error)
    if not offsets:
        raise UserError(f"{name}: {why}")
    cameras = [item.subject.camera for item in fitted if item.subject.camera is not None]
    common = float(np.exp(np.mean(np.log([camera.fx for camera in cameras]))))
    seen = [eye[np.isfinite(eye).all(axis=1)] for eye in np.stack(offsets, axis=1)]
    known = np.stack([np.median(eye, axis=0) if len(eye) else np.zeros(3) for eye in seen])
    return Person(replace(fitted[0].subject, name=Path(name).stem), common, known)
