"""A field whose every answer is known: an ellipsoid face and two spheres for eyes.

It implements `BoundField`, so what measures and exports trained fields can be tested against the
truth. Faults can be injected: parts moved or scaled, eyes that look elsewhere than they were told.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
import torch

from gazenerf.errors import UserError
from gazenerf.geometry import Camera, Gaze
from gazenerf.geometry.paths import BeyondTraining, GazeRange
from gazenerf.heads.interface import PARTS, BoundField, GeometryView, Part, RenderedView
from gazenerf.subjects import Codes, Subject

IRIS_COSINE = 0.87
"""Cosine between the gaze and the rim of the painted iris."""


def analytic_subject() -> Subject:
    """A subject with empty codes."""
    empty = np.zeros(0, np.float32)
    return Subject("analytic", Codes(empty, empty, empty, np.zeros(27, np.float32)), provenance={"trained": False})


@dataclass(frozen=True)
class Ellipsoid:
    """An axis-aligned ellipsoid: centre (3,) and radii (3,), world units."""

    centre: np.ndarray
    radii: np.ndarray

    def level(self, points: torch.Tensor) -> torch.Tensor:
        """(N,) below 1 inside, 1 on the surface, at points (N, 3)."""
        centre = torch.as_tensor(self.centre, dtype=points.dtype)
        return ((points - centre) / torch.as_tensor(self.radii, dtype=points.dtype)).norm(dim=-1)

    def intersect(self, rays_o: np.ndarray, rays_d: np.ndarray) -> np.ndarray:
        """(...,) first distance along unit rays, inf where they miss."""
        o, d = (rays_o - self.centre) / self.radii, rays_d / self.radii
        a, b, c = (d * d).sum(-1), (o * d).sum(-1), (o * o).sum(-1) - 1.0
        under = b * b - a * c
        return np.where(under > 0, (-b - np.sqrt(np.maximum(under, 0.0))) / a, np.inf)

    def normals(self, points: np.ndarray) -> np.ndarray:
        """(..., 3) unit outward normals at points on the surface."""
        gradient = (points - self.centre) / self.radii**2
        return gradient / np.linalg.norm(gradient, axis=-1, keepdims=True)


class AnalyticField:
    """An exact `BoundField`.

    Args:
        gaze: Where the eyes are told to look.
        subject: Whose name it carries.
        face_offset: (3,) moves the face, world units.
        face_scale: Scales the face about its centre.
        eye_offset: (3,) moves the left eye.
        gaze_error: (pitch, yaw) in radians added to what the eyes do.
        sharpness: Width over which density falls from `solid` to zero across the surface, as a share
            of the radius; the surface lies at half of `solid`.
        solid: Density inside, per world unit.
    """

    def __init__(
        self,
        gaze: Gaze | None = None,
        subject: Subject | None = None,
        *,
        face_offset: tuple[float, float, float] = (0.0, 0.0, 0.0),
        face_scale: float = 1.0,
        eye_offset: tuple[float, float, float] = (0.0, 0.0, 0.0),
        gaze_error: tuple[float, float] = (0.0, 0.0),
        sharpness: float = 0.02,
        solid: float = 200.0,
    ) -> None:
        self.gaze = gaze or Gaze()
        self.subject = subject or analytic_subject()
        self.seen_gaze = Gaze(self.gaze.pitch + gaze_error[0], self.gaze.yaw + gaze_error[1])
        self.box = np.array([[-1.5, -1.5, -1.5], [1.5, 1.5, 1.5]])
        self.metres_per_unit = 0.1
        self.weights_hash = "analytic"
        self.surface_spread: float | None = None
        self.image_size: int | None = None
        self.background = np.zeros(3, np.float32)
        self.sharpness, self.solid = sharpness, solid
        self.face = Ellipsoid(np.array(face_offset), face_scale * np.array([0.8, 1.1, 0.9]))
        self.eyes = (
            Ellipsoid(np.array([0.32, 0.1, 0.8]) + np.array(eye_offset), np.full(3, 0.12)),
            Ellipsoid(np.array([-0.32, 0.1, 0.8]), np.full(3, 0.12)),
        )

    @property
    def device(self) -> torch.device:
        """Exact fields are computed on the CPU."""
        return torch.device("cpu")

    @property
    def parts(self) -> tuple[Part, ...]:
        """Both streams and their combination."""
        return PARTS

    def solids(self, part: Part) -> tuple[Ellipsoid, ...]:
        """The ellipsoids of a part.

        Raises:
            UserError: unknown part.
        """
        if part not in PARTS:
            raise UserError(f"unknown part {part!r}; there are {', '.join(PARTS)}")
        return {"face": (self.face,), "eyes": self.eyes, "head": (self.face, *self.eyes)}[part]

    def density(self, points: torch.Tensor, part: Part = "head") -> torch.Tensor:
        """See `BoundField`; half of `solid` on the surface, a linear ramp across it."""
        total = torch.zeros(len(points), dtype=points.dtype)
        for solid in self.solids(part):
            total = total + self.solid * (0.5 + (1.0 - solid.level(points)) / self.sharpness).clamp(0.0, 1.0)
        return total

    def render_geometry(self, camera: Camera, part: Part = "head", normals: bool = False) -> GeometryView:
        """See `BoundField`; exact intersections."""
        distance, points, solid = self._hit(camera, part)
        vectors = None
        if normals:
            vectors = np.full((*distance.shape, 3), np.nan, np.float32)
            for i, shape in enumerate(self.solids(part)):
                vectors[solid == i] = shape.normals(points[solid == i])
        seen = np.isfinite(distance)
        depth = np.where(seen, distance, np.nan).astype(np.float32)
        return GeometryView(camera, seen.astype(np.float32), depth, vectors)

    def render(self, camera: Camera, parts: tuple[Part, ...] = ("head",)) -> RenderedView:
        """See `BoundField`; a smooth pattern on the face, a dark iris on white eyes, no light."""
        images: dict[Part, np.ndarray] = {}
        geometry: dict[Part, GeometryView] = {}
        for part in parts:
            _, points, solid = self._hit(camera, part)
            first_eye = 0 if part == "eyes" else 1
            image = np.zeros((camera.height, camera.width, 3), np.float32)
            wave = 0.5 + 0.25 * np.sin(5.0 * points) * np.cos(3.0 * np.roll(points, 1, axis=-1))
            skin = (solid >= 0) & (solid < first_eye)
            image[skin] = wave[skin]
            for i, eye in enumerate(self.eyes):
                here = solid == first_eye + i
                if part == "face":
                    continue
                look = (points[here] - eye.centre) @ self.seen_gaze.vector() / eye.radii[0]
                image[here] = np.where(look[:, None] > IRIS_COSINE, 0.1, 0.9)
            images[part] = image
            geometry[part] = self.render_geometry(camera, part)
        return RenderedView(camera, images, geometry)

    def _hit(self, camera: Camera, part: Part) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Distance (H, W), points (H, W, 3) and index of the solid (H, W), -1 where nothing is hit."""
        rays_o, rays_d = camera.rays()
        hits = np.stack([solid.intersect(rays_o, rays_d) for solid in self.solids(part)])
        distance = hits.min(axis=0)
        seen = np.isfinite(distance)
        points = rays_o + np.where(seen, distance, 0.0)[..., None] * rays_d
        return distance, points, np.where(seen, hits.argmin(axis=0), -1)


class AnalyticHead:
    """A head made of exact fields; see `gazenerf.heads.interface.HeadField`.

    Args:
        make: Gaze to the exact field.
    """

    def __init__(self, make: Callable[[Gaze], BoundField] = AnalyticField) -> None:
        self._make = make

    @property
    def device(self) -> torch.device:
        """Exact fields are computed on the CPU."""
        return torch.device("cpu")

    @property
    def subject(self) -> Subject:
        """Of the field that looks straight ahead."""
        return self._make(Gaze()).subject

    @property
    def trained_range(self) -> GazeRange | None:
        """Every gaze is exact."""
        return None

    def check(self, gazes: Gaze | Iterable[Gaze]) -> BeyondTraining | None:
        """No gaze is beyond what it was trained on."""
        return None

    def at(self, gaze: Gaze) -> BoundField:
        """The field at a gaze."""
        return self._make(gaze)
