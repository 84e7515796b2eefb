"""The bundled parametric head: linear shape and albedo, true eyeballs, lids that follow the gaze."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np

from gazenerf.errors import UserError
from gazenerf.geometry import Gaze
from gazenerf.head_model.eyes import IRIS_CODES, RADIUS_MM, build_eye_mesh
from gazenerf.head_model.interface import EYE_LEFT, EYE_RIGHT, FACE, HeadMesh
from gazenerf.head_model.subdivision import subdivide, triangles
from gazenerf.subjects import Codes

ASSET = Path(__file__).parent.parent / "assets" / "head_model.npz"
MAX_ASSET_BYTES = 64 * 2**20
METRES_PER_UNIT = 0.1
EYE_RADIUS = RADIUS_MM / 1000.0 / METRES_PER_UNIT
LID_CLEARANCE = 0.055 * EYE_RADIUS
LID_OPENING = np.array([1.3, 1.65, 1.0])
"""How much wider, in x and y, the lids open on the anatomical eyeball than on the source's larger one."""

LID_PITCH, LID_YAW = np.deg2rad(28.0), np.deg2rad(38.0)
"""Gaze angles at which the eyeLook lid shapes are fully on."""


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
        self.occlusion = data["occlusion"].astype(np.float32) / 255.0
        self.landmarks = data["landmarks"].astype(np.int64)
        self.variance_kept = float(data["variance_kept"])
        self._matrix, fine = subdivide(data["quads"].astype(np.int64), len(self.template), int(data["levels"]))
        self._matrix = self._matrix.astype(np.float32)
        self._faces = triangles(fine).astype(np.int32)
        self._index = {label: i for i, label in enumerate(self.expression_names)}
        self.code_sizes = (
            len(self.identity),
            len(self.expression),
            len(self.albedo_basis) + IRIS_CODES,
            27,
        )

    def lids(self, gaze: Gaze) -> np.ndarray:
        """(E,) expression coefficients that make the lids follow a gaze."""
        out = np.zeros(len(self.expression), dtype=np.float32)
        up, left = gaze.pitch / LID_PITCH, gaze.yaw / LID_YAW
        pairs = {
            "eyeLookUpLeft": up,
            "eyeLookUpRight": up,
            "eyeLookDownLeft": -up,
            "eyeLookDownRight": -up,
            "eyeLookOutLeft": left,
            "eyeLookInRight": left,
            "eyeLookInLeft": -left,
            "eyeLookOutRight": -left,
        }
        for label, amount in pairs.items():
            out[self._index[label]] = np.clip(amount, 0.0, 1.2)
        return out

    def eye_centres(self, identity: np.ndarray) -> np.ndarray:
        """(2, 3) centres of rotation, left then right, world units."""
        source = self.source_eyes + np.tensordot(identity, self.source_eyes_identity, 1)
        return source + np.array([0.0, 0.0, self.source_radius - EYE_RADIUS], dtype=np.float32)

    def mesh(self, codes: Codes, gaze: Gaze) -> HeadMesh:
        """The posed head with both eyes at `gaze`.

        Raises:
            UserError: codes of other sizes than `code_sizes`.
        """
        if codes.sizes != self.code_sizes:
            raise UserError(f"the head model {self.name} takes codes of {self.code_sizes}, got {codes.sizes}")
        expression = codes.expression + self.lids(gaze)
        base = (
            self.template
            + np.tensordot(codes.identity, self.identity, 1)
            + np.tensordot(expression, self.expression, 1)
        )
        centres = self.eye_centres(codes.identity)
        source = self.source_eyes + np.tensordot(codes.identity, self.source_eyes_identity, 1)
        for old, new in zip(source, centres, strict=True):
            base = _fit_lids(base, old, self.source_radius, new)
        skin = self._matrix @ base.astype(np.float32)
        for centre in centres:
            skin = _push_out(skin, centre, EYE_RADIUS + LID_CLEARANCE)
        skin_albedo = np.clip(
            self.albedo_mean + np.tensordot(codes.texture[: len(self.albedo_basis)], self.albedo_basis, 1), 0.008, 0.92
        )
        eye = build_eye_mesh()
        eye_albedo = eye.albedo(codes.texture[len(self.albedo_basis) :])
        rotation = gaze.rotation()
        turned = (eye.vertices @ rotation.T).astype(np.float32)
        eyes = [centre + EYE_RADIUS * turned for centre in centres]
        count, n_eye = len(skin), len(eye.vertices)
        shadow = _lid_shadow(turned)
        vertices = np.concatenate([skin, *eyes]).astype(np.float32)
        faces = np.concatenate([self._faces, eye.faces + count, eye.faces + count + n_eye])
        marks = {str(i): vertices[vertex] for i, vertex in enumerate(self.landmarks)}
        marks["iris_left"] = vertices[count + eye.iris]
        marks["iris_right"] = vertices[count + n_eye + eye.iris]
        return HeadMesh(
            vertices=vertices,
            faces=faces.astype(np.int32),
            face_part=np.repeat(
                np.array([FACE, EYE_LEFT, EYE_RIGHT], np.uint8), [len(self._faces), len(eye.faces), len(eye.faces)]
            ),
            normals=vertex_normals(vertices, faces),
            albedo=np.concatenate([skin_albedo, eye_albedo, eye_albedo]).astype(np.float32),
            landmarks=marks,
            eye_centres=centres.astype(np.float64),
            eye_radius=EYE_RADIUS,
            metres_per_unit=METRES_PER_UNIT,
            occlusion=np.concatenate([self.occlusion, shadow, shadow]).astype(np.float32),
        )


def _smoothstep(low: float, high: float, values: np.ndarray) -> np.ndarray:
    t = np.clip((values - low) / (high - low), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def _fit_lids(vertices: np.ndarray, old: np.ndarray, radius: float, new: np.ndarray) -> np.ndarray:
    """Move the skin about an eyeball (centre `old`, `radius`) to one of anatomical size about `new`."""
    offset = vertices - old
    distance = np.maximum(np.linalg.norm(offset, axis=1, keepdims=True), 1e-6)
    gap = distance - radius
    weight = 1.0 - _smoothstep(0.02, 0.16, gap)
    direction = offset / distance
    opened = direction * LID_OPENING
    opened /= np.maximum(np.linalg.norm(opened, axis=1, keepdims=True), 1e-6)
    ahead = _smoothstep(0.1, 0.5, direction[:, 2:])
    direction = direction + ahead * (opened - direction)
    target = new + direction * (EYE_RADIUS + gap)
    return vertices + weight * (target - vertices)


def _push_out(vertices: np.ndarray, centre: np.ndarray, radius: float) -> np.ndarray:
    """Vertices inside a ball moved to its surface."""
    near = np.flatnonzero((np.abs(vertices - centre) < radius).all(axis=1))
    offset = vertices[near] - centre
    distance = np.maximum(np.linalg.norm(offset, axis=1, keepdims=True), 1e-6)
    vertices[near] = centre + offset * np.maximum(1.0, radius / distance)
    return vertices


def _lid_shadow(directions: np.ndarray) -> np.ndarray:
    """(V,) occlusion of an eyeball's surface by the lids, from directions in the head frame."""
    upper = _smoothstep(0.12, 0.62, directions[:, 1])
    corner = _smoothstep(0.45, 0.9, np.abs(directions[:, 0]))
    return (1.0 - 0.55 * upper) * (1.0 - 0.35 * corner) * (1.0 - 0.15 * _smoothstep(0.3, 0.8, -directions[:, 1]))


def vertex_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(V, 3) float32 unit normals, faces weighted by area."""
    a, b, c = (vertices[faces[:, i]].astype(np.float64) for i in range(3))
    cross = np.cross(b - a, c - a)
    normals = np.stack(
        [np.bincount(faces.ravel(), np.repeat(cross[:, i], 3), minlength=len(vertices)) for i in range(3)], axis=1
    )
    return (normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)).astype(np.float32)


@lru_cache(maxsize=2)
def load_head_model(path: str | Path | None = None) -> ParametricHead:
    """The bundled head model, or one built by the same script from a path.

    Raises:
        UserError: the file is missing, too large or damaged.
    """
    path = ASSET if path is None else Path(path)
    if not path.is_file():
        raise UserError(f"no head model at {path}; rebuild it with scripts/build_head_model.py")
    if path.stat().st_size > MAX_ASSET_BYTES:
        raise UserError(f"{path} is larger than a head model can be ({MAX_ASSET_BYTES >> 20} MiB)")
    try:
        with np.load(path, allow_pickle=False) as file:
            return ParametricHead({key: file[key] for key in file.files}, "makehuman-cc0-1")
    except (OSError, KeyError, ValueError, IndexError) as error:
        raise UserError(f"cannot read the head model {path}: {error}") from error
