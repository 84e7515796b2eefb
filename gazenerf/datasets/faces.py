"""Landmarks and masks of the pictures of a data set: from files, from the data set, or by MediaPipe."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gazenerf.datasets.published import Sample
from gazenerf.errors import UserError
from gazenerf.photographs.detector import Detection, detect, photo_python
from gazenerf.photographs.fit_options import PERSON
from gazenerf.photographs.landmarks import SUFFIXES, FaceLandmarks, choose_face, read_labels, read_landmarks, read_mask

SOURCES = ("mediapipe", "dataset")
"""What `--landmarks` takes beside a folder."""


@dataclass(frozen=True)
class FaceFiles:
    """Where landmarks and masks come from.

    Attributes:
        landmarks: One of `SOURCES`, or a folder of files `<subject>/<picture>.npy` (or .npz, .json, .csv).
        masks: Folder of `<subject>/<picture>.png`, white where the person is; None where there are none.
        labels: Folder of `<subject>/<picture>.png`, a face parser's labels; None where there are none.
        photo_python: Interpreter that has MediaPipe; see `gazenerf.photographs.detector.photo_python`.
    """

    landmarks: str
    masks: Path | None = None
    labels: Path | None = None
    photo_python: Path | None = None

    def check(self) -> None:
        """Refuse what is not there.

        Raises:
            UserError: MediaPipe is absent, or a folder.
        """
        if self.landmarks == "mediapipe":
            photo_python(self.photo_python)
        elif self.landmarks != "dataset" and not Path(self.landmarks).is_dir():
            raise UserError(
                f"--landmarks {self.landmarks} is no folder; give one, or {' or '.join(SOURCES)} (docs/datasets.md)"
            )
        for name in ("masks", "labels"):
            folder = getattr(self, name)
            if folder is not None and not folder.is_dir():
                raise UserError(f"--{name} {folder} is no folder; it holds a folder of pictures for each subject")


@dataclass(frozen=True)
class Face:
    """The face in one picture.

    Attributes:
        landmarks: Pixels of the picture.
        person: (H, W) bool, where the person is; None where unknown.
        labels: (H, W) uint8 of a face parser; None where unknown.
    """

    landmarks: FaceLandmarks
    person: np.ndarray | None = None
    labels: np.ndarray | None = None


def find_faces(files: FaceFiles, subject: str, pictures: Sequence[tuple[str, Sample]]) -> list[Face | UserError]:
    """The face of each picture, or why there is none.

    Args:
        files: Where from.
        subject: Whose.
        pictures: Names and pictures.

    Raises:
        UserError: MediaPipe fails as a whole.
    """
    detections: list[Detection | None] = [None] * len(pictures)
    if files.landmarks == "mediapipe" and pictures:
        detections = list(detect([sample.pixels for _, sample in pictures], files.photo_python))
    found: list[Face | UserError] = []
    for (name, sample), detection in zip(pictures, detections, strict=True):
        try:
            found.append(_face(files, subject, name, sample, detection))
        except UserError as error:
            found.append(error)
    return found


def _face(files: FaceFiles, subject: str, name: str, sample: Sample, detection: Detection | None) -> Face:
    size = sample.pixels.shape[1], sample.pixels.shape[0]
    person = None
    if detection is not None:
        # a normalised picture is of the face in its middle, so the largest one is meant
        landmarks, person = choose_face(detection.faces[:1], None, name), detection.person >= PERSON
    elif files.landmarks == "dataset":
        if sample.landmarks is None:
            raise UserError(f"the data set has no landmarks for {name}; take --landmarks mediapipe or a folder")
        landmarks = sample.landmarks
    else:
        landmarks = choose_face(read_landmarks(_file(Path(files.landmarks) / subject, name, SUFFIXES)), None, name)
    if files.masks is not None:
        person = read_mask(_file(files.masks / subject, name, (".png",)), size)
    labels = None if files.labels is None else read_labels(_file(files.labels / subject, name, (".png",)), size)
    return Face(landmarks, person, labels)


def _file(folder: Path, name: str, suffixes: Sequence[str]) -> Path:
    for suffix in suffixes:
        if (path := folder / f"{name}{suffix}").is_file():
            return path
    raise UserError(f"there is no {folder / name}{'|'.join(suffixes)}")
