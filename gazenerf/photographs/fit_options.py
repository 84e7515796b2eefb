"""What a user says of photographs to be fitted, and the photographs read with it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gazenerf.errors import UserError
from gazenerf.options import option
from gazenerf.photographs.detector import Detection, detect
from gazenerf.photographs.fit import Photograph
from gazenerf.photographs.landmarks import choose_face, read_labels, read_landmarks, read_mask
from gazenerf.photographs.picture import read_photograph
from gazenerf.photographs.tuning import METHODS

PERSON = 0.5
"""Probability from which a pixel counts as the person."""


@dataclass(frozen=True, kw_only=True)
class FitOptions:
    """How photographs are fitted.

    Attributes:
        landmarks, masks, labels: One file for each photograph, instead of what MediaPipe finds.
        face: Number of the face from 1, the largest first; None where there is one.
        focal: Pixels, where it is known.
        head_model, landmark_table: Instead of the bundled ones.
        photo_python: Interpreter that has MediaPipe; see `gazenerf.photographs.detector.photo_python`.
    """

    landmarks: tuple[Path, ...] = option(
        (), "a file for each photograph: 478 or 68 points in pixels (.npy, .npz, .json, .csv)", metavar="FILE"
    )
    masks: tuple[Path, ...] = option((), "a picture for each photograph, white where the person is", metavar="FILE")
    labels: tuple[Path, ...] = option((), "a face parser's label image for each photograph (0 to 18)", metavar="FILE")
    face: int | None = option(None, "which face, from 1, the largest first, where there are several", metavar="N")
    focal: float | None = option(None, "focal length in pixels, where it is known", metavar="PX")
    head_model: Path | None = option(None, "another head model (docs/head-model.md)", metavar="FILE")
    landmark_table: Path | None = option(None, "its landmark table (docs/photos.md)", metavar="FILE")
    photo_python: Path | None = option(None, "interpreter that has MediaPipe (docs/photos.md)", metavar="PYTHON")

    def __post_init__(self) -> None:
        if self.focal is not None and not 1.0 <= self.focal <= 1e6:
            raise UserError(f"--focal is in pixels, 1 to 1000000, got {self.focal:g}")


@dataclass(frozen=True, kw_only=True)
class FieldFitOptions(FitOptions):
    """How photographs are fitted, and a field to them.

    Attributes:
        hair: Fit the head model's hair to the outline and to the hair's border.
        field: Fine-tune a field; without, the head model alone is fitted.
        method: How the field is fine-tuned; see `gazenerf.photographs.tuning.METHODS`.
        quick: Fewer steps from fewer views, less like the person.
        checkpoint: The field; what is learned is of no use to another.
        preview: PNG of how far the field is; the picture beside the subject by default.
        preview_every: Seconds between two previews.
    """

    hair: bool = option(
        True, "fit hair with volume, where the photograph shows any, which is the default",
        off=("--no-hair", "hair is painted on the head"),
    )  # fmt: skip
    field: bool = option(
        True, "fine-tune the field to the person, which is the default",
        off=("--no-field", "fit the head model alone, in seconds; a field then draws a similar stranger"),
    )  # fmt: skip
    method: str = option(
        METHODS[0],
        "teacher (default): colours, from the head model that wears the photograph; paper: codes and network, from the "
        "masked photograph alone",
        choices=METHODS,
    )
    quick: bool = option(False, "fine-tune the field in fewer steps from fewer views: sooner, and less like the person")
    checkpoint: Path | None = option(
        None,
        "the field that is fine-tuned, and that the subject is to be drawn by (default: portrait-sdf)",
        metavar="FIELD",
    )
    preview: Path | None = option(
        None, "picture of how far the field is, rewritten while it learns (default: the one beside --out)",
        metavar="FILE.png",
    )  # fmt: skip
    preview_every: float = option(20.0, "seconds between two previews (default: 20)", metavar="SECONDS")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.method not in METHODS:
            raise UserError(f"--method is {' or '.join(METHODS)}, got {self.method!r}")
        if not self.field and (self.quick or self.checkpoint is not None or self.method != METHODS[0]):
            raise UserError("--quick, --method and --checkpoint are about the field; leave out --no-field")
        if not self.field and self.preview is not None:
            raise UserError("--preview shows the field; leave out --no-field")
        if self.preview is not None and self.preview.suffix != ".png":
            raise UserError(f"--preview {self.preview} must end in .png")
        if not 1.0 <= self.preview_every <= 1e6:
            raise UserError(f"--preview-every is in seconds, 1 to 1000000, got {self.preview_every:g}")


def read_photographs(files: Sequence[Path], options: FitOptions) -> list[Photograph]:
    """Photographs with their landmarks and masks, as the user gave them or as they are detected.

    Raises:
        UserError: a file cannot be read, has no face, or the numbers of files differ.
    """
    for name in ("landmarks", "masks", "labels"):
        given = len(getattr(options, name))
        if given not in (0, len(files)):
            raise UserError(f"--{name} takes one file for each photograph: {len(files)}, got {given}")
    pictures = [read_photograph(file) for file in files]
    found: list[Detection | None] = [None] * len(files)
    if not options.landmarks:
        found = list(detect(pictures, options.photo_python))
    photographs = []
    for i, (file, pixels) in enumerate(zip(files, pictures, strict=True)):
        size, detection = (pixels.shape[1], pixels.shape[0]), found[i]
        faces = read_landmarks(options.landmarks[i]) if detection is None else detection.faces
        landmarks = choose_face(faces, options.face, str(file))
        person = None if detection is None else detection.person >= PERSON
        if options.masks:
            person = read_mask(options.masks[i], size)
        labels = read_labels(options.labels[i], size) if options.labels else None
        if not _overlaps(landmarks.points, size):
            raise UserError(f"the landmarks of {file} lie outside its {size[0]}x{size[1]} pixels")
        photographs.append(Photograph(file.name, pixels, landmarks, person, labels, options.focal))
    return photographs


def _overlaps(points: np.ndarray, size: tuple[int, int]) -> bool:
    return bool(((points > 0) & (points < size)).all(axis=1).mean() > 0.5)
