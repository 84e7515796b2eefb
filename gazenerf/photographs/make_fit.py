"""Photographs on disk become subject files, each with an overlay and a JSON file beside it."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from gazenerf.errors import UserError
from gazenerf.files import refuse_existing, whole_file
from gazenerf.head_model import load_head_model
from gazenerf.options import option
from gazenerf.photographs.detector import Detection, detect
from gazenerf.photographs.fit import FittedPhotograph, Photograph, fit_photographs
from gazenerf.photographs.landmarks import choose_face, read_labels, read_landmarks, read_mask
from gazenerf.photographs.overlay import overlay
from gazenerf.photographs.picture import read_photograph

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


@dataclass(frozen=True)
class MadeFit:
    """What was written for one photograph, and what was fitted."""

    subject: Path
    overlay: Path
    json: Path
    fitted: FittedPhotograph


def make_fit(
    photographs: Sequence[Path], out: Path, options: FitOptions | None = None, overwrite: bool = False
) -> list[MadeFit]:
    """Fit the head model to photographs of one person and write a subject for each.

    Args:
        photographs: PNG, JPEG or WebP.
        out: Subject file of the first photograph; those of others get their number before the suffix.
        options: How they are fitted.
        overwrite: Replace files.

    Raises:
        UserError: anything in the input that a user can mend.
    """
    options = options or FitOptions()
    if out.suffix != ".safetensors":
        raise UserError(f"--out {out} must end in .safetensors")
    targets = [_targets(out, number) for number in range(len(photographs))]
    refuse_existing([file for files in targets for file in files], overwrite)
    model = load_head_model(options.head_model)
    started = time.perf_counter()
    fitted = fit_photographs(read_photographs(photographs, options), model, options.landmark_table)
    seconds = time.perf_counter() - started
    made = []
    for (subject, picture, about), item in zip(targets, fitted, strict=True):
        with whole_file(picture) as temporary:
            Image.fromarray(overlay(item)).save(temporary)
        said = {
            "photograph": item.subject.provenance["photograph"],
            "subject": subject.name,
            "fine_tuned": False,
            "seconds_for_all_photographs": seconds,
            "warnings": item.warnings,
            **item.residuals,
        }
        with whole_file(about) as temporary:
            temporary.write_text(json.dumps(said, indent=2) + "\n", encoding="utf-8")
        item.subject.save(subject)
        made.append(MadeFit(subject, picture, about, item))
    return made


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


def _targets(out: Path, number: int) -> tuple[Path, Path, Path]:
    stem = out.stem if number == 0 else f"{out.stem}-{number + 1}"
    return out.with_name(f"{stem}.safetensors"), out.with_name(f"{stem}.overlay.png"), out.with_name(f"{stem}.json")
