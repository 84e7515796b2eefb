"""Head models from a user's `.npz` file; docs/head-model.md describes the format."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gazenerf.errors import UserError
from gazenerf.geometry import Gaze
from gazenerf.head_model.assembly import assemble
from gazenerf.head_model.eyes import IRIS_CODES, RADIUS_MM, with_eye_albedo
from gazenerf.head_model.interface import HeadMesh
from gazenerf.head_model.lids import lid_coefficients, push_out
from gazenerf.head_model.points import LinearAlbedo, SkinPoints
from gazenerf.subjects import Codes

FORMAT = "gazenerf-head-model-1"
METRES_PER_UNIT = 0.1
LID_CLEARANCE = 0.055
MAX_VERTICES = 500_000
MAX_CODES = 1024


class GenericHead:
    """A linear head model with the eyeballs of this package set into it.

    Args:
        arrays: As docs/head-model.md lists them.
        source: Where they came from, for messages.

    Raises:
        UserError: an array is missing or does not fit the others.
    """

    def __init__(self, arrays: dict[str, np.ndarray], source: str | Path) -> None:
        self._source = source
        for key in ("vertices", "faces", "eye_centres", "landmarks"):
            if key not in arrays:
                raise self._wrong(f"`{key}` is missing")
        scale = self._scalar(arrays, "metres_per_unit", METRES_PER_UNIT, 1e-6, 10.0) / METRES_PER_UNIT
        self.name = str(arrays["name"]) if "name" in arrays else Path(source).stem
        vertices = self._floats(arrays, "vertices", (None, 3))
        count = len(vertices)
        if not 4 <= count <= MAX_VERTICES:
            raise self._wrong(f"`vertices` has {count} rows; 4 to {MAX_VERTICES} are possible")
        self.template = vertices * np.float32(scale)
        self.faces = self._indices(arrays, "faces", (None, 3), count)
        if len(self.faces) == 0:
            raise self._wrong("`faces` is empty")
        self._marks = self._indices(arrays, "landmarks", (68,), count)
        self.identity = self._basis(arrays, "identity", count) * np.float32(scale)
        self.expression = self._basis(arrays, "expression", count) * np.float32(scale)
        self.albedo_basis = self._basis(arrays, "albedo", count)
        grey = np.full((count, 3), 0.35, np.float32)
        self.albedo_mean = self._floats(arrays, "albedo_mean", (count, 3)) if "albedo_mean" in arrays else grey
        self._eyes = self._floats(arrays, "eye_centres", (2, 3)) * np.float32(scale)
        still = np.zeros((len(self.identity), 2, 3), np.float32)
        self._eyes_identity = (
            self._floats(arrays, "eye_centres_identity", still.shape) * np.float32(scale)
            if "eye_centres_identity" in arrays
            else still
        )
        if self._eyes[0, 0] <= self._eyes[1, 0]:
            raise self._wrong("`eye_centres` has the subject's left eye, the one at larger x, first")
        usual = RADIUS_MM / 1000.0 / METRES_PER_UNIT / scale
        self.eye_radius = self._scalar(arrays, "eye_radius", usual, 1e-6, 1e6) * scale
        self.expression_names = self._names(arrays, len(self.expression))
        self.code_sizes = (len(self.identity), len(self.expression), len(self.albedo_basis) + IRIS_CODES, 27)

    @property
    def hair_names(self) -> tuple[str, ...]:
        """None: files have no hair."""
        return ()

    def eye_centres(self, identity: np.ndarray) -> np.ndarray:
        """(2, 3) centres of rotation, left then right, world units."""
        return self._eyes + np.tensordot(identity, self._eyes_identity, 1)

    def mesh(self, codes: Codes, gaze: Gaze) -> HeadMesh:
        """The posed head with both eyes at `gaze`; lids follow where the file names eyeLook* coefficients.

        Raises:
            UserError: codes of other sizes than `code_sizes`.
        """
        if codes.sizes != self.code_sizes:
            raise UserError(f"the head model {self.name} takes codes of {self.code_sizes}, got {codes.sizes}")
        expression = codes.expression + lid_coefficients(self.expression_names, gaze)
        skin = (
            self.template
            + np.tensordot(codes.identity, self.identity, 1)
            + np.tensordot(expression, self.expression, 1)
        ).astype(np.float32)
        centres = self.eye_centres(codes.identity)
        for centre in centres:
            skin = push_out(skin, centre, (1.0 + LID_CLEARANCE) * self.eye_radius)
        looks = len(self.albedo_basis)
        albedo = np.clip(self.albedo_mean + np.tensordot(codes.texture[:looks], self.albedo_basis, 1), 0.0, 1.0)
        return assemble(
            skin, self.faces, albedo, self._marks, centres, self.eye_radius, codes.texture[looks:], gaze,
            METRES_PER_UNIT,
        )  # fmt: skip

    @property
    def landmark_vertices(self) -> np.ndarray:
        """(68,) vertices of the skin that are the standard landmarks."""
        return self._marks

    def skin_points(self, vertices: np.ndarray) -> SkinPoints:
        """Vertices (K,) of the skin as a differentiable function of codes and gaze."""
        return SkinPoints(
            self.template[vertices], self.identity[:, vertices], self.expression[:, vertices], np.eye(len(vertices)),
            self.expression_names, self._eyes, self._eyes_identity, self.eye_radius, LID_CLEARANCE * self.eye_radius,
        )  # fmt: skip

    def albedo_at(self, vertices: np.ndarray) -> LinearAlbedo:
        """Albedo of vertices (K,) of `mesh` as a function of the texture code."""
        return with_eye_albedo(self.albedo_mean, self.albedo_basis, (0.0, 1.0), vertices)

    def _wrong(self, what: str) -> UserError:
        return UserError(f"the head model {self._source}: {what}; see docs/head-model.md for the format")

    def _floats(self, arrays: dict[str, np.ndarray], key: str, shape: tuple[int | None, ...]) -> np.ndarray:
        value = arrays[key]
        fits = value.ndim == len(shape) and all(w is None or w == h for w, h in zip(shape, value.shape, strict=True))
        if value.dtype.kind not in "fiu" or not fits:
            wanted = ", ".join("any" if size is None else str(size) for size in shape)
            raise self._wrong(f"`{key}` must hold numbers of shape ({wanted}), got {value.dtype} {value.shape}")
        if not np.isfinite(value).all():
            raise self._wrong(f"`{key}` holds NaN or infinite values")
        return np.array(value, dtype=np.float32)

    def _basis(self, arrays: dict[str, np.ndarray], key: str, count: int) -> np.ndarray:
        if key not in arrays:
            return np.zeros((0, count, 3), np.float32)
        basis = self._floats(arrays, key, (None, count, 3))
        if len(basis) > MAX_CODES:
            raise self._wrong(f"`{key}` has {len(basis)} components; at most {MAX_CODES} are possible")
        return basis

    def _indices(self, arrays: dict[str, np.ndarray], key: str, shape: tuple[int | None, ...], count: int):
        if arrays[key].dtype.kind not in "iu":
            raise self._wrong(f"`{key}` must hold integers, got {arrays[key].dtype}")
        self._floats(arrays, key, shape)
        if arrays[key].size and (arrays[key].min() < 0 or arrays[key].max() >= count):
            raise self._wrong(f"`{key}` names vertices outside 0..{count - 1}")
        return arrays[key].astype(np.int32)

    def _scalar(self, arrays: dict[str, np.ndarray], key: str, usual: float, low: float, high: float) -> float:
        if key not in arrays:
            return usual
        value = float(self._floats(arrays, key, ()))
        if not low <= value <= high:
            raise self._wrong(f"`{key}` is {value:g}; {low:g} to {high:g} is possible")
        return value

    def _names(self, arrays: dict[str, np.ndarray], count: int) -> tuple[str, ...]:
        if "expression_names" not in arrays:
            return tuple(f"expression{i}" for i in range(count))
        names = arrays["expression_names"]
        if names.dtype.kind != "U" or names.shape != (count,):
            raise self._wrong(f"`expression_names` must hold {count} strings, got {names.dtype} {names.shape}")
        return tuple(str(name) for name in names)
