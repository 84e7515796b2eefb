"""The bundled parametric head: linear shape and albedo, true eyeballs, lids that follow the gaze."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import overload

import numpy as np
import torch

from gazenerf.errors import UserError
from gazenerf.geometry import Gaze
from gazenerf.head_model.assembly import assemble
from gazenerf.head_model.assets import BUNDLED, read_arrays
from gazenerf.head_model.eyes import IRIS_CODES, RADIUS_MM, with_eye_albedo
from gazenerf.head_model.generic import FORMAT, METRES_PER_UNIT, GenericHead
from gazenerf.head_model.hair import Hair
from gazenerf.head_model.interface import HeadMesh
from gazenerf.head_model.lids import fit_lids, followed, lid_coefficients, push_out
from gazenerf.head_model.mouth import Mouth
from gazenerf.head_model.points import LinearAlbedo, OtherEyeballs, SkinPoints, double
from gazenerf.head_model.subdivision import subdivide, triangles
from gazenerf.subjects import Codes

BUNDLED_NAME = "makehuman-cc0-1"
EYE_RADIUS = RADIUS_MM / 1000.0 / METRES_PER_UNIT
LID_CLEARANCE = 0.055 * EYE_RADIUS
LOWEST, HIGHEST = 0.008, 0.92
"""Albedo of the skin is clipped to these."""

LASH_DARKNESS = 0.55
"""Share of the light that lashes take from the skin on which they are painted."""


class ParametricHead:
    """A head derived from the CC0 MakeHuman data (see docs/head-model.md).

    Args:
        data: Arrays of the asset, as scripts/build_head_model.py writes them.
        name: Names the model in files.
    """

    def __init__(self, data: dict[str, np.ndarray], name: str) -> None:
        self.name = name
        self.template = data["template"].astype(np.float32)
        self.identity = data["identity"].astype(np.float32)
        self.expression = data["expression"].astype(np.float32)
        self.expression_names = tuple(str(item) for item in data["expression_names"])
        self.source_eyes = data["eyes"].astype(np.float32)
        self.source_eyes_identity = data["eyes_identity"].astype(np.float32)
        self.source_radius = float(data["eye_radius"])
        self.albedo_mean = data["albedo_mean"].astype(np.float32)
        self.albedo_basis = (
            data["albedo_basis"].astype(np.float32) * data["albedo_scale"].astype(np.float32)[:, None, None]
        )
        lashes = data["lashes"].astype(np.float32) / 255.0 if "lashes" in data else np.zeros(1, np.float32)
        self.lash_light = np.broadcast_to(1.0 - LASH_DARKNESS * lashes, len(self.albedo_mean))
        self.albedo_mean = self.albedo_mean * self.lash_light[:, None]
        self.albedo_basis = self.albedo_basis * self.lash_light[:, None]
        self.occlusion = data["occlusion"].astype(np.float32) / 255.0
        self.landmarks = data["landmarks"].astype(np.int64)
        self.variance_kept = float(data["variance_kept"])
        self._matrix, fine = subdivide(data["quads"].astype(np.int64), len(self.template), int(data["levels"]))
        self._matrix = self._matrix.astype(np.float32)
        self._faces = triangles(fine).astype(np.int32)
        self.mouth = Mouth.of(data)
        self.hair = Hair.of(data)
        self.code_sizes = (
            len(self.identity),
            len(self.expression),
            len(self.albedo_basis) + IRIS_CODES,
            27,
        )

    def driven(self, expression: np.ndarray, gaze: Gaze) -> np.ndarray:
        """(E,) float32 coefficients of a face with an expression (E,) whose lids follow a gaze, eyeLook* among them."""
        return self.followed(expression, gaze) + lid_coefficients(self.expression_names, gaze)

    def followed(self, expression: np.ndarray, gaze: Gaze) -> np.ndarray:
        """(E,) float32 the same without eyeLook*; see `gazenerf.head_model.lids.followed`."""
        pitch = torch.tensor(gaze.pitch, dtype=torch.float64)
        own = followed(self.expression_names, torch.tensor(expression, dtype=torch.float64), pitch)
        return own.numpy().astype(np.float32)

    def eye_centres(self, identity: np.ndarray) -> np.ndarray:
        """(2, 3) centres of rotation, left then right, world units."""
        return self._eyes_ahead + self.source_eyes + np.tensordot(identity, self.source_eyes_identity, 1)

    @property
    def hair_names(self) -> tuple[str, ...]:
        """Of the hair codes."""
        return () if self.hair is None else self.hair.names

    @property
    def _eyes_ahead(self) -> np.ndarray:
        """(3,) by which the eyeballs lie ahead of the larger ones that the skin was made for: corneas meet."""
        return np.array([0.0, 0.0, self.source_radius - EYE_RADIUS], dtype=np.float32)

    @property
    def landmark_vertices(self) -> np.ndarray:
        """(68,) vertices of the skin that are the standard landmarks."""
        return self.landmarks

    def skin_points(self, vertices: np.ndarray) -> SkinPoints:
        """Vertices (K,) of the skin as a differentiable function of codes and gaze."""
        mix = self._matrix.tocsr()[vertices]
        used = np.unique(mix.indices)
        return SkinPoints(
            self.template[used], self.identity[:, used], self.expression[:, used], mix[:, used].toarray(),
            self.expression_names, self.source_eyes + self._eyes_ahead, self.source_eyes_identity, EYE_RADIUS,
            LID_CLEARANCE,
            OtherEyeballs(double(self.source_eyes), double(self.source_eyes_identity), self.source_radius), True,
        )  # fmt: skip

    def albedo_at(self, vertices: np.ndarray) -> LinearAlbedo:
        """Albedo of vertices (K,) of `mesh` as a function of the texture code."""
        inside = None if self.mouth is None else self.mouth.albedo
        return with_eye_albedo(self.albedo_mean, self.albedo_basis, (LOWEST, HIGHEST), vertices, inside)

    def mesh(self, codes: Codes, gaze: Gaze) -> HeadMesh:
        """The posed head with both eyes at `gaze`; with hair where the hair code is not empty.

        Raises:
            UserError: codes of other sizes than `code_sizes`, or a longer hair code than `hair_names`; what a shorter
                one lacks is 0.
        """
        if codes.sizes != self.code_sizes:
            raise UserError(f"the head model {self.name} takes codes of {self.code_sizes}, got {codes.sizes}")
        if codes.hair.size > len(self.hair_names):
            raise UserError(
                f"the head model {self.name} takes up to {len(self.hair_names)} hair codes, got {codes.hair.size}"
            )
        expression = self.driven(codes.expression, gaze)
        base = (
            self.template
            + np.tensordot(codes.identity, self.identity, 1)
            + np.tensordot(expression, self.expression, 1)
        )
        moved = base - self.template
        centres = self.eye_centres(codes.identity)
        source = self.source_eyes + np.tensordot(codes.identity, self.source_eyes_identity, 1)
        for old, new in zip(source, centres, strict=True):
            base = fit_lids(base, old, self.source_radius, new, EYE_RADIUS)
        skin = self._matrix @ base.astype(np.float32)
        for centre in centres:
            skin = push_out(skin, centre, EYE_RADIUS + LID_CLEARANCE)
        looks = len(self.albedo_basis)
        inside = self.mouth
        mouth = inside and (inside.vertices(codes.identity, expression), inside.faces, inside.albedo)
        albedo = np.clip(self.albedo_mean + np.tensordot(codes.texture[:looks], self.albedo_basis, 1), LOWEST, HIGHEST)
        cut, hair = codes.hair, None
        if self.hair is not None and cut.any():
            shape, shade = self.hair.vertices(cut, moved), self.hair.albedo(codes.texture[:looks])
            hair = shape, self.hair.faces, shade, self.hair.light(cut)
        return assemble(
            skin, self._faces, albedo, self.landmarks, centres, EYE_RADIUS, codes.texture[looks:], gaze,
            METRES_PER_UNIT, self.occlusion, mouth, hair,
        )  # fmt: skip


def _load(path: Path) -> ParametricHead | GenericHead:
    arrays = read_arrays(path)
    if "format" in arrays:
        if str(arrays["format"]) != FORMAT:
            raise UserError(f"{path} has the format {str(arrays['format'])!r}; this version reads {FORMAT!r}")
        return GenericHead(arrays, path)
    try:
        return ParametricHead(arrays, path.stem)
    except (KeyError, ValueError, IndexError, TypeError) as error:
        raise UserError(f"{path} is not a head model ({error}); docs/head-model.md describes the format") from error


@lru_cache(maxsize=1)
def _bundled() -> ParametricHead:
    return ParametricHead(read_arrays(BUNDLED), BUNDLED_NAME)


@overload
def load_head_model(path: None = None) -> ParametricHead: ...
@overload
def load_head_model(path: str | Path) -> ParametricHead | GenericHead: ...
def load_head_model(path: str | Path | None = None) -> ParametricHead | GenericHead:
    """The bundled head model, or one from a user's file.

    Args:
        path: An `.npz` in the generic format (docs/head-model.md), or one that
            scripts/build_head_model.py wrote; None for the bundled one.

    Raises:
        UserError: the file is missing, too large, damaged, or its arrays do not fit together.
    """
    return _bundled() if path is None else _load(Path(path))
