"""Which vertex of a head model a detector's landmark is, and how its detections err.

Made by scripts/landmark_correspondences.py from renders of the head model: for each landmark the vertex whose
projection lies nearest to the detections, and how detections miss it. Misses are not independent: jaw landmarks slide
as the head turns, irises follow the gaze only in part, unusual faces are drawn more usual than they are, and a whole
brow is missed together. So the table has the mean miss as a linear function of head pose, gaze and identity, and the
principal components of what that leaves.
"""

from __future__ import annotations

import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from gazenerf.errors import UserError
from gazenerf.files import reading_numpy
from gazenerf.head_model.interface import HeadModel
from gazenerf.head_model.model import BUNDLED_NAME
from gazenerf.photographs.landmarks import DENSE_WITHOUT_IRISES, IRISES

FORMAT = "gazenerf-landmark-table-1"
BUNDLED = Path(__file__).parent.parent / "assets" / "landmarks.npz"
MAX_BYTES = 16 * 2**20
MAX_COMPONENTS = 128

MOST_SPREAD_MM = 6.0
"""Landmarks that spread more are not used: they slide over the surface as the head turns."""

STANDARD_AMONG_DENSE = (
    162, 234, 93, 58, 172, 136, 149, 148, 152, 377, 378, 365, 397, 288, 323, 454, 389,
    70, 63, 105, 66, 107, 336, 296, 334, 293, 300, 168, 197, 5, 4, 75, 97, 2, 326, 305,
    33, 160, 158, 133, 153, 144, 362, 385, 387, 263, 373, 380,
    61, 39, 37, 0, 267, 269, 291, 405, 314, 17, 84, 181, 78, 82, 13, 312, 308, 317, 14, 87,
)  # fmt: skip
"""MediaPipe's point for each of the standard 68."""

STANDARD_SPREAD_MM = np.repeat([9.0, 4.0, 2.5, 2.0, 2.5], [17, 10, 9, 12, 20])
"""What is assumed of 68-point detectors: the jaw slides, lids are sharp. Not measured."""

IRIS_SPREAD_MM = 1.0


COMPONENT_SHARE, NOISE_SHARE = 0.5, 0.2
"""Share of a component's deviation that is taken for such, and of its variance that is taken for independent noise. The
misses of renders are not all those of photographs: with whole components a fit explains away what the photograph shows
of a jaw."""

POSE_FEATURES = 7


@dataclass(frozen=True)
class LandmarkTable:
    """Landmarks that are used, in the order of the arrays; the centres of the irises may be the last two.

    Attributes:
        landmarks: (L,) indices among the detector's points.
        vertices: (L,) of the head model's skin; (L - 2,) where the irises are among the landmarks.
        spread_mm: (L,) median distance of detections from what they stand for.
        offset_mm: (L, 2) mean miss of a frontal mean head that looks ahead, in a frame whose x axis runs along the eyes
            to the subject's left, y down.
        slopes_mm: (F + I, L, 2) change of the mean miss per unit of `pose_features` and of the identity code.
        components_mm: (C, L, 2) misses that go together; each is one standard deviation of its own amount.
        noise_mm: (L,) standard deviation, on each axis, of what the components leave.
    """

    landmarks: np.ndarray
    vertices: np.ndarray
    spread_mm: np.ndarray
    offset_mm: np.ndarray
    slopes_mm: np.ndarray
    components_mm: np.ndarray
    noise_mm: np.ndarray

    @property
    def has_irises(self) -> bool:
        """Whether the last two landmarks are the irises, the subject's left first."""
        return len(self.landmarks) == len(self.vertices) + 2

    @classmethod
    def load(cls, path: Path, model: HeadModel) -> LandmarkTable:
        """A table that scripts/landmark_correspondences.py wrote for a head model.

        Raises:
            UserError: missing, too large, damaged, or made for another head model.
        """
        arrays = _read(path)
        if str(arrays["model"]) != model.name or arrays["slopes_mm"].shape[0] != POSE_FEATURES + model.code_sizes[0]:
            raise UserError(
                f"{path} was made for the head model {str(arrays['model'])!r}, not for {model.name!r}; make one by "
                "scripts/landmark_correspondences.py"
            )
        used = arrays["spread_mm"] < MOST_SPREAD_MM
        used[-2:] = True
        marks = np.concatenate([np.arange(DENSE_WITHOUT_IRISES), IRISES])
        vertices = arrays["vertices"][used[:-2]].astype(int)
        offset, slopes, components = (
            arrays[key][..., used, :].astype(float) for key in ("offset_mm", "slopes_mm", "components_mm")
        )
        spread, noise = (arrays[key][used].astype(float) for key in ("spread_mm", "noise_mm"))
        noise = np.sqrt(np.square(noise) + NOISE_SHARE * np.square(components).sum(axis=0).mean(axis=-1))
        return cls(marks[used], vertices, spread, offset, slopes, COMPONENT_SHARE * components, noise)

    @classmethod
    def standard(cls, model: HeadModel, dense: bool) -> LandmarkTable:
        """The standard 68 landmarks of any head model; nothing is known of how detections miss them.

        Args:
            model: The head model.
            dense: Whether they are looked for among MediaPipe's points, with its irises.
        """
        landmarks, spread = np.arange(68), STANDARD_SPREAD_MM
        if dense:
            landmarks = np.concatenate([STANDARD_AMONG_DENSE, IRISES])
            spread = np.append(STANDARD_SPREAD_MM, [IRIS_SPREAD_MM] * 2)
        none = np.zeros((len(landmarks), 2))
        slopes = np.zeros((POSE_FEATURES + model.code_sizes[0], *none.shape))
        return cls(
            landmarks, np.asarray(model.landmark_vertices, dtype=int), spread, none, slopes, none[None][:0], spread
        )

    def without_irises(self) -> LandmarkTable:
        """The same landmarks without the irises."""
        if not self.has_irises:
            return self
        rows = (self.offset_mm[:-2], self.slopes_mm[:, :-2], self.components_mm[:, :-2])
        return LandmarkTable(self.landmarks[:-2], self.vertices, self.spread_mm[:-2], *rows, self.noise_mm[:-2])


def pose_features(view: torch.Tensor, gaze: torch.Tensor) -> torch.Tensor:
    """(F,) what the mean miss depends on: yaw and pitch of the camera about the head, their products, and the gaze.

    Args:
        view: (3,) from the head's origin to the camera, head frame.
        gaze: (2,) pitch and yaw, radians.
    """
    yaw, pitch = torch.atan2(view[0], view[2]), torch.asin((view[1] / view.norm()).clamp(-0.99, 0.99))
    return torch.stack([yaw, pitch, yaw * yaw, pitch * pitch, yaw * pitch, gaze[0], gaze[1]])


def table_for(model: HeadModel, dense: bool, path: Path | None = None) -> LandmarkTable:
    """The landmark table of a head model.

    Args:
        model: The head model.
        dense: Whether MediaPipe's points are given, instead of the standard 68.
        path: Of a table made for this model; by default the bundled one where it is the bundled head model, else the
            standard landmarks of the model.

    Raises:
        UserError: the file is not a table for this model.
    """
    if dense and path is not None:
        return LandmarkTable.load(path, model)
    if dense and model.name == BUNDLED_NAME:
        return LandmarkTable.load(BUNDLED, model)
    return LandmarkTable.standard(model, dense)


POINTS = DENSE_WITHOUT_IRISES + 2
SHAPES = {"vertices": (DENSE_WITHOUT_IRISES,), "spread_mm": (POINTS,), "offset_mm": (POINTS, 2),
          "slopes_mm": (None, POINTS, 2), "components_mm": (None, POINTS, 2), "noise_mm": (POINTS,)}  # fmt: skip


def _read(path: Path) -> dict[str, np.ndarray]:
    if not path.is_file():
        raise UserError(f"no landmark table at {path}; scripts/landmark_correspondences.py makes one")
    try:
        with zipfile.ZipFile(path) as archive:
            if sum(member.file_size for member in archive.infolist()) > MAX_BYTES:
                raise UserError(f"{path} unpacks to more than a landmark table holds ({MAX_BYTES >> 20} MiB)")
        with reading_numpy(), np.load(path, allow_pickle=False) as file:
            arrays = {key: np.asarray(file[key]) for key in ("format", "model", *SHAPES)}
    except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile, zlib.error, NotImplementedError) as error:
        raise UserError(f"{path} is no landmark table ({str(error)[:120]})") from error
    if str(arrays["format"]) != FORMAT:
        raise UserError(f"{path} has the format {str(arrays['format'])!r}; this version reads {FORMAT!r}")
    for key, shape in SHAPES.items():
        found = arrays[key]
        fits = len(shape) == found.ndim and all(a in (None, b) for a, b in zip(shape, found.shape, strict=True))
        if not fits or found.dtype.kind not in "fiu" or not np.isfinite(found).all():
            raise UserError(f"{path}: `{key}` must hold numbers of shape {shape}, got {found.dtype} {found.shape}")
    if len(arrays["components_mm"]) > MAX_COMPONENTS or arrays["vertices"].min() < 0:
        raise UserError(f"{path} is no landmark table (too many components, or vertices below 0)")
    return arrays
