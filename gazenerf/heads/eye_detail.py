"""What a feature map is too coarse to show of eyes, drawn on the eyeballs: fibres of the iris, and mirrored light.

Both are the head model's own. Fibres turn with the gaze; the highlight stays between light and camera. No training
is needed: where the eyeballs are is known, and the field's distances tell where lids and hair lie before them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np
import torch

from gazenerf.field.detail import DARK
from gazenerf.geometry import Camera
from gazenerf.head_model import load_head_model
from gazenerf.head_model.eyes import RINGS_END, build_eye_mesh, surface_radius
from gazenerf.head_model.model import EYE_RADIUS
from gazenerf.head_model.shading import highlight, linear_to_srgb, srgb_to_linear
from gazenerf.heads.feature_map import FeatureGrid, RayFeatures
from gazenerf.subjects import Codes

if TYPE_CHECKING:
    from gazenerf.heads.bound import BoundHead

BEFORE = (0.0, 0.01, 0.02, 0.04, 0.08)
"""World units before an eyeball's surface, along a ray, at which nothing of the face may be."""

BESIDE_LIDS = (0.002, 0.008)
"""Distances from lids and hair, world units, at which nothing and all of the detail is drawn."""

HIDDEN = 0.2
"""What a picture shows so far before an eyeball, world units, hides it."""

FINEST, MOST_RAYS = 0.004, 4
"""World units between the rays that are averaged in a pixel, and most of them along one side of it."""

FAINT = 0.01
"""Linear light, or logarithm of a ratio, below which nothing is drawn."""

PASSES = 3
"""Corrections of where a ray meets the bulging cornea."""


@dataclass(frozen=True)
class EyeDetail:
    """The eyes of one person.

    Attributes:
        centres: (2, 3) of the eyeballs, world units.
        radius: Of the eyeballs, world units.
        illumination: (27,).
        angles: (R,) of rings about the optical axis, radians.
        fibres: (R, A + 1) float32: by how much the iris is brighter there than its ring is on average, as logarithms
            of sRGB with `DARK` added; the first column again at the end.
        mirrors: Whether light is mirrored; it is where the camera sees it, so textures have none.
    """

    centres: np.ndarray
    radius: float
    illumination: np.ndarray
    angles: np.ndarray
    fibres: np.ndarray
    mirrors: bool = True

    def shown(
        self, number: int, turn: np.ndarray, points: np.ndarray, rays: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Fibres (N,) and mirrored light (N,) of an eye; see `fibres` and `highlight`.

        Args:
            number: Of the eye.
            turn: (3, 3) rotation of the gaze.
            points: (N, 3) on its surface.
            rays: (N, 3) unit, towards it.
        """
        places = (points - self.centres[number]) / self.radius
        local = places @ turn
        angle = np.arctan2(np.hypot(local[:, 0], local[:, 1]), local[:, 2])
        around = np.arctan2(local[:, 1], local[:, 0]) % (2.0 * np.pi) / (2.0 * np.pi) * (self.fibres.shape[1] - 1)
        ring = np.interp(angle, self.angles, np.arange(len(self.angles)))
        at = around.astype(np.float32)[:, None], ring.astype(np.float32)[:, None]
        fibres = cv2.remap(self.fibres, *at, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)[:, 0]
        mirrored = highlight(places, turn[:, 2], -rays, self.illumination) if self.mirrors else np.zeros(len(points))
        return fibres, mirrored

    def surface(
        self, number: int, turn: np.ndarray, origins: np.ndarray, rays: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Distances (N,) along rays (N, 3) at which they meet an eye's surface, and whether they do (N,)."""
        offset = origins - self.centres[number]
        along = (offset * rays).sum(axis=1)
        aside = np.maximum((offset**2).sum(axis=1) - along**2, 0.0)
        radius = np.full(len(rays), self.radius)
        for _ in range(PASSES):
            outward = offset + _nearer(along, aside, radius)[:, None] * rays
            cosine = outward @ turn[:, 2] / np.linalg.norm(outward, axis=1)
            radius = self.radius * surface_radius(np.arccos(np.clip(cosine, -1.0, 1.0)))
        return _nearer(along, aside, radius), aside < radius**2


def _nearer(along: np.ndarray, aside: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """(N,) distance at which rays first meet spheres, or come nearest to them."""
    return -along - np.sqrt(np.maximum(radius**2 - aside, 0.0))


def eye_detail(codes: Codes) -> EyeDetail:
    """The eyes of a person of the bundled head model."""
    model, eye = load_head_model(), build_eye_mesh()
    rings = eye.albedo(codes.texture[len(model.albedo_basis) :])[1:-1].reshape(len(eye.ring_angles), -1, 3)
    iris = eye.ring_angles <= RINGS_END
    bright = np.log(linear_to_srgb(rings[iris]).mean(axis=-1) + DARK)
    fibres = bright - bright.mean(axis=1, keepdims=True)
    fibres = np.concatenate([fibres, fibres[:, :1]], axis=1).astype(np.float32)
    centres = np.asarray(model.eye_centres(codes.identity), dtype=np.float64)
    return EyeDetail(centres, EYE_RADIUS, codes.illumination, eye.ring_angles[iris], fibres)


def with_eye_detail(
    bounds: Sequence[BoundHead], pictures: torch.Tensor, grid: FeatureGrid, seen: RayFeatures, lids: bool = True
) -> torch.Tensor:
    """Pictures of a head with fibres and highlights on its eyes, where its field asks for them.

    Args:
        bounds: One head at the gaze of each picture.
        pictures: (B, 3, h * k, w * k) sRGB, or one of them, before they are cut out by a matte.
        grid: The rays of their feature maps.
        seen: Along these rays.
        lids: Whether the face is drawn, and may lie before the eyes.
    """
    eyes = bounds[0].head.eye_detail
    if eyes is None:
        return pictures
    detailed = pictures.clone().reshape(-1, *pictures.shape[-3:])
    distances = seen.distance.reshape(-1, *grid.shape).cpu().numpy()
    for picture, bound, small, distance in zip(detailed, bounds, grid.cameras, distances, strict=True):
        height, width = picture.shape[1:]
        camera = small.resized(width, height)
        for number in range(len(eyes.centres)):
            _draw(eyes, number, bound, picture, camera, distance, lids)
    return detailed.reshape(pictures.shape)


def _draw(
    eyes: EyeDetail, number: int, bound: BoundHead, picture: torch.Tensor, camera: Camera, distance: np.ndarray,
    lids: bool,
) -> None:  # fmt: skip
    """Draw one eye's detail in a picture (3, H, W), in place; `distance` (h, w) is what its feature map shows."""
    window = _window(eyes, number, camera)
    if window is None:
        return
    left, top, view = window
    turn = bound.gaze.rotation()
    away = float(np.linalg.norm(eyes.centres[number] - camera.position))
    finer = int(np.clip(np.ceil(away / camera.fx / FINEST), 1, MOST_RAYS))
    origins, rays = _rays(view.resized(view.width * finer, view.height * finer))
    length, met = eyes.surface(number, turn, origins, rays)
    fibres, shine = np.zeros(len(rays), np.float32), np.zeros(len(rays))
    points = origins + length[:, None] * rays
    fibres[met], shine[met] = eyes.shown(number, turn, points[met], rays[met])
    fibres, shine = (
        values.reshape(view.height, finer, view.width, finer).mean(axis=(1, 3)).ravel() for values in (fibres, shine)
    )
    origins, rays = _rays(view)
    length, met = eyes.surface(number, turn, origins, rays)
    column, row = np.meshgrid(np.arange(view.width) + left, np.arange(view.height) + top)
    scale = np.array(distance.shape) / [camera.height, camera.width]
    before = distance[(row.ravel() * scale[0]).astype(int), (column.ravel() * scale[1]).astype(int)]
    drawn = np.flatnonzero(met & ((np.abs(fibres) > FAINT) | (shine > FAINT)) & (length < before + HIDDEN))
    if not len(drawn):
        return
    share = np.ones(len(drawn))
    if lids:
        share = _uncovered(bound, origins[drawn] + length[drawn, None] * rays[drawn], rays[drawn])
    at = (slice(None), torch.from_numpy(row.ravel()[drawn]), torch.from_numpy(column.ravel()[drawn]))
    colour = picture[at].T.float().cpu().numpy()
    colour = (colour + DARK) * np.exp(fibres[drawn] * share)[:, None] - DARK
    colour = linear_to_srgb(srgb_to_linear(colour) + (shine[drawn] * share)[:, None])
    picture[at] = torch.from_numpy(colour.T.astype(np.float32)).to(picture)


def _window(eyes: EyeDetail, number: int, camera: Camera) -> tuple[int, int, Camera] | None:
    """Left, top and camera of the part of a picture that an eyeball may be in; None where it is outside or behind."""
    (middle,), (z,) = camera.project(eyes.centres[number][None])
    if z <= 2.0 * eyes.radius:
        return None
    reach = 1.1 * eyes.radius / z * np.array([camera.fx, camera.fy])
    return camera.part_between(middle - reach, middle + reach)


def _rays(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Origins and directions (N, 3) through the middles of a camera's pixels, row after row."""
    origins, rays = camera.rays()
    return origins.reshape(-1, 3), rays.reshape(-1, 3)


def _uncovered(bound: BoundHead, points: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """(N,) share of an eye's surface at points (N, 3) that neither lids nor hair cover from where rays (N, 3) come."""
    steps = np.array(BEFORE)[:, None, None]
    along = torch.from_numpy((points - steps * rays).astype(np.float32)).to(bound.device)
    stream, condition = bound.field.stream("face"), bound.conditions["face"]
    distance = stream.signed_distance(along.reshape(1, -1, 3), condition).reshape(len(BEFORE), -1)
    low, high = BESIDE_LIDS
    return ((distance.amin(dim=0) - low) / (high - low)).clamp(0.0, 1.0).double().cpu().numpy()
