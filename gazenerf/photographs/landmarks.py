"""Landmarks, masks and label images of a face, as a detector or the user gives them."""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gazenerf.errors import UserError
from gazenerf.files import check_name, read_json, reading_numpy
from gazenerf.photographs.picture import read_grey

MAX_LANDMARK_BYTES = 4 * 2**20
MAX_FACES = 64
SUFFIXES = (".npy", ".npz", ".json", ".csv")

DENSE, DENSE_WITHOUT_IRISES, STANDARD = 478, 468, 68
"""Points of MediaPipe's face mesh with and without its refined irises, and of the 68-point annotation (iBUG 300-W)."""

IRISES = (473, 468)
"""Centres of the subject's left and right iris among the 478."""

IN_THE_FACE_OVAL = (1, 2, 3, 10, 11, 12, 13)
"""Labels of CelebAMask-HQ's face parsers (BiSeNet's order) whose pixels show skin, brows, nose and lips."""

PARSER_LABELS = 19


@dataclass(frozen=True)
class FaceLandmarks:
    """Points of one face in one picture.

    Attributes:
        points: (478, 2), (468, 2) or (68, 2) float64 pixels, continuous: pixel centres lie at .5. The indices are those
            of MediaPipe's face mesh, or of the standard 68 points.
    """

    points: np.ndarray

    @property
    def dense(self) -> bool:
        """Whether these are MediaPipe's points."""
        return len(self.points) != STANDARD

    @property
    def irises(self) -> np.ndarray | None:
        """(2, 2) centres of the irises, the subject's left first; None where they were not detected."""
        return self.points[list(IRISES)] if len(self.points) == DENSE else None

    @property
    def eyes(self) -> np.ndarray:
        """(2, 2) middles between the corners of the eyes, the subject's left first."""
        corners = ((263, 362), (33, 133)) if self.dense else ((45, 42), (36, 39))
        return np.stack([self.points[list(pair)].mean(axis=0) for pair in corners])

    @property
    def interocular(self) -> float:
        """Distance in pixels between the middles of the eyes."""
        left, right = self.eyes
        return float(np.linalg.norm(left - right))

    @property
    def eye_axes(self) -> np.ndarray:
        """(2, 2) rows: unit image direction along the eyes to the subject's left, and the one down from it."""
        left, right = self.eyes
        x, y = (left - right) / max(self.interocular, 1e-9)
        return np.array([[x, y], [-y, x]])


def as_landmarks(array: np.ndarray, source: str = "the landmarks") -> list[FaceLandmarks]:
    """Faces from an array of pixel coordinates.

    Args:
        array: (N, 2), (N, 3) or (F, N, 2 or 3), N being 478, 468 or 68; a third coordinate is ignored.
        source: Where they came from, for messages.

    Raises:
        UserError: another shape, not numbers, not finite, or the points lie all in one place.
    """
    array = np.asarray(array)
    if array.dtype.kind not in "fiu":
        raise UserError(f"{source} must hold numbers, got {array.dtype}; give pixel coordinates")
    faces = array[None] if array.ndim == 2 else array
    known = (DENSE, DENSE_WITHOUT_IRISES, STANDARD)
    if faces.ndim != 3 or faces.shape[1] not in known or faces.shape[2] not in (2, 3) or len(faces) > MAX_FACES:
        raise UserError(f"{source} has the shape {array.shape}; give 478, 468 or 68 rows of x and y in pixels")
    points = np.array(faces[..., :2], dtype=np.float64)
    if not np.isfinite(points).all():
        raise UserError(f"{source} holds NaN or infinite values")
    if len(points) and np.ptp(points, axis=1).max(axis=-1).min() <= 2.0:
        raise UserError(f"{source} spans less than 2 pixels; give pixels, not shares of the picture's size")
    return [FaceLandmarks(face) for face in points]


def read_landmarks(path: Path) -> list[FaceLandmarks]:
    """Faces from an .npy, .npz (its first array, or `landmarks`), .json (nested lists) or .csv file (x,y rows).

    Raises:
        UserError: missing, larger than 4 MiB, of another kind, damaged, or not landmarks.
    """
    check_name(path)
    if path.suffix.lower() not in SUFFIXES:
        raise UserError(f"{path} is no landmark file; give {', '.join(SUFFIXES)}")
    if path.suffix.lower() == ".json":
        value = read_json(path, MAX_LANDMARK_BYTES, absent="give a file of landmarks", large="landmarks are smaller")
        return as_landmarks(_numbers(value, path), str(path))
    try:
        if path.stat().st_size > MAX_LANDMARK_BYTES:
            raise UserError(f"{path} is larger than {MAX_LANDMARK_BYTES >> 20} MiB; landmarks are smaller")
        with reading_numpy():
            return as_landmarks(_array(path), str(path))
    except FileNotFoundError as error:
        raise UserError(f"{path} does not exist; give a file of landmarks") from error
    except (OSError, ValueError, EOFError, KeyError, NotImplementedError, zipfile.BadZipFile, zlib.error) as error:
        raise UserError(f"{path} cannot be read as landmarks: {str(error)[:120]}") from error


def _numbers(value: object, path: Path) -> np.ndarray:
    value = value.get("landmarks") if isinstance(value, dict) else value
    try:
        return np.array(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise UserError(f"{path} is no list of [x, y] pairs, nor has `landmarks` that are") from error


def _array(path: Path) -> np.ndarray:
    suffix = path.suffix.lower()
    if suffix == ".csv":
        with path.open(encoding="utf-8-sig") as file:
            header = not all(_is_number(word) for word in file.readline().split(","))
        return np.loadtxt(path, delimiter=",", skiprows=int(header), encoding="utf-8-sig")
    if suffix == ".npy":
        return np.load(path, mmap_mode="r", allow_pickle=False)
    with zipfile.ZipFile(path) as archive:
        if sum(member.file_size for member in archive.infolist()) > MAX_LANDMARK_BYTES:
            raise UserError(f"{path} unpacks to more than {MAX_LANDMARK_BYTES >> 20} MiB; landmarks are smaller")
    with np.load(path, allow_pickle=False) as arrays:
        if not arrays.files:
            raise UserError(f"{path} holds no array")
        return arrays["landmarks" if "landmarks" in arrays.files else arrays.files[0]]


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def choose_face(faces: Sequence[FaceLandmarks], face: int | None, source: str) -> FaceLandmarks:
    """The face that is meant.

    Args:
        faces: As found, the largest first.
        face: Number of the face from 1; may be None where there is one.
        source: Of the faces, for messages.

    Raises:
        UserError: there is no face, no face of that number, or there are several and no number was given.
    """
    if not faces:
        raise UserError(
            f"no face was found in {source}; crop it so that the face is at least a tenth of its width, look towards "
            "the camera (profiles are not found), or give landmarks with --landmarks"
        )
    if face is None and len(faces) > 1:
        places = "; ".join(f"--face {i + 1} at {_place(found)}" for i, found in enumerate(faces))
        raise UserError(f"{source} has {len(faces)} faces; choose one: {places}")
    if face is not None and not 1 <= face <= len(faces):
        raise UserError(f"{source} has {len(faces)} face{'s' * (len(faces) > 1)}; there is no --face {face}")
    return faces[0 if face is None else face - 1]


def _place(face: FaceLandmarks) -> str:
    x, y = face.points.mean(axis=0)
    return f"({x:.0f}, {y:.0f}) px"


def read_mask(path: Path, size: tuple[int, int]) -> np.ndarray:
    """(H, W) bool: where a picture of the same size is at least half white.

    Raises:
        UserError: it cannot be read or has another size than (width, height).
    """
    return _of_size(read_grey(path), path, size) >= 128


def read_labels(path: Path, size: tuple[int, int]) -> np.ndarray:
    """(H, W) uint8 labels of a face parser, 0 to 18 in the order of CelebAMask-HQ's BiSeNet.

    Raises:
        UserError: it cannot be read, has another size than (width, height), or other labels.
    """
    labels = _of_size(read_grey(path, indices=True), path, size)
    if labels.max() >= PARSER_LABELS:
        raise UserError(f"{path} holds labels up to {labels.max()}; a face parser's are 0 to {PARSER_LABELS - 1}")
    return labels


def _of_size(image: np.ndarray, path: Path, size: tuple[int, int]) -> np.ndarray:
    if image.shape != size[::-1]:
        raise UserError(f"{path} is {image.shape[1]}x{image.shape[0]}, the photograph {size[0]}x{size[1]}")
    return image
