"""Texture and light codes from the pixels of photographs, with the fitted shape held.

Vertices that a photograph shows inside the face oval, but neither between the lips nor between the lids, are compared
with the colour of their pixels; see `gazenerf.photographs.looks`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from scipy.optimize import minimize

from gazenerf.data.rasterizer import Raster
from gazenerf.geometry import Camera
from gazenerf.head_model.interface import FACE, HeadMesh, HeadModel
from gazenerf.head_model.points import double
from gazenerf.photographs.irises import lids
from gazenerf.photographs.landmarks import IN_THE_FACE_OVAL, FaceLandmarks
from gazenerf.photographs.looks import LitVertices, LookPriors

FACE_OVAL = (
    10, 338, 297, 332, 284, 251, 389, 356, 454, 323, 361, 288, 397, 365, 379, 378, 400, 377, 152, 148, 176, 149, 150,
    136, 172, 58, 132, 93, 234, 127, 162, 21, 54, 103, 67, 109,
)  # fmt: skip
INNER_LIPS = (78, 191, 80, 81, 82, 13, 312, 311, 310, 415, 308, 324, 318, 402, 317, 14, 87, 178, 88, 95)
"""MediaPipe's outlines."""

STANDARD_OVAL, STANDARD_LIPS = tuple(range(27)), tuple(range(60, 68))

MOST_VERTICES, MOST_EYE_VERTICES = 6000, 1200
SKIN_DEVIATION, EYE_DEVIATION = 0.05, 0.10
"""sRGB: what a pixel may miss."""

SKIN_WEIGHT, EYE_WEIGHT = 400.0, 60.0
"""How many independent pixels all vertices together count as: neighbours err alike."""

FACING, DEPTH_UNITS = 0.25, 0.03


@dataclass(frozen=True)
class Seen:
    """One photograph and the fitted head in it, at one size.

    Attributes:
        image: (H, W, 3) uint8 sRGB.
        landmarks: In it.
        camera, mesh, raster: Of the fitted head.
        person: (H, W) bool, where the picture shows the person; None is everywhere.
        labels: (H, W) uint8 of a face parser; None where there are none.
    """

    image: np.ndarray
    landmarks: FaceLandmarks
    camera: Camera
    mesh: HeadMesh
    raster: Raster
    person: np.ndarray | None = None
    labels: np.ndarray | None = None


def face_oval(landmarks: FaceLandmarks, shape: tuple[int, int]) -> np.ndarray:
    """(H, W) bool: inside the outline of the face, from brow or hairline to chin."""
    return _filled(landmarks, FACE_OVAL if landmarks.dense else STANDARD_OVAL, shape, hull=not landmarks.dense)


def above_chin(mesh: HeadMesh, camera: Camera, share: float = 1.0) -> np.ndarray:
    """(H, W) bool: pixels above the chin, or a share of the way from the brows to it, along the line between them."""
    return below_chin(mesh, camera, share) < 0.0


def below_chin(mesh: HeadMesh, camera: Camera, share: float = 1.0) -> np.ndarray:
    """(H, W) pixels by which each lies below the chin, or a share of the way from the brows to it, along that line."""
    chin, brows = camera.project(np.stack([mesh.landmarks["8"], mesh.landmarks["27"]]).astype(np.float64))[0]
    down = (chin - brows) / max(float(np.linalg.norm(chin - brows)), 1e-9)
    return (camera.pixel_centres() - (brows + share * (chin - brows))) @ down


def skin_mask(seen: Seen) -> np.ndarray:
    """(H, W) bool: pixels that tell the skin's colour."""
    shape = seen.image.shape[:2]
    grow = max(1, round(0.04 * seen.landmarks.interocular))
    kernel = np.ones((2 * grow + 1, 2 * grow + 1), np.uint8)
    skin = cv2.erode(face_oval(seen.landmarks, shape).astype(np.uint8), kernel, borderValue=0) > 0
    lips = between_lips(seen.landmarks, shape)
    openings = eye_openings(seen.landmarks, shape)
    skin &= cv2.dilate((lips | openings).astype(np.uint8), kernel) == 0
    skin &= seen.raster.parts == 1
    if seen.person is not None:
        skin &= seen.person
    return skin if seen.labels is None else skin & np.isin(seen.labels, IN_THE_FACE_OVAL)


def between_lips(landmarks: FaceLandmarks, shape: tuple[int, int]) -> np.ndarray:
    """(H, W) bool: where the mouth is open."""
    return _filled(landmarks, INNER_LIPS if landmarks.dense else STANDARD_LIPS, shape)


def eye_openings(landmarks: FaceLandmarks, shape: tuple[int, int]) -> np.ndarray:
    """(H, W) bool: between the lids."""
    mask = np.zeros(shape, np.uint8)
    cv2.fillPoly(mask, [np.round(outline).astype(np.int32) for outline in lids(landmarks)], 1)
    return mask > 0


def _filled(landmarks: FaceLandmarks, outline: Sequence[int], shape: tuple[int, int], hull: bool = False) -> np.ndarray:
    points = np.round(landmarks.points[list(outline)]).astype(np.int32)
    mask = np.zeros(shape, np.uint8)
    cv2.fillPoly(mask, [cv2.convexHull(points) if hull else points], 1)
    return mask > 0


@dataclass(frozen=True)
class _Colours:
    """Vertices of one photograph: the colours of their pixels (N, 3), normals (N, 3), and what they are made of."""

    observed: torch.Tensor
    normals: torch.Tensor
    lit: LitVertices
    deviation: float
    weight: float

    def cost(self, texture: torch.Tensor, light: torch.Tensor) -> torch.Tensor:
        square = ((self.lit.colours(self.normals, texture, light) - self.observed) / self.deviation).square()
        return self.weight * ((1.0 + square).sqrt() - 1.0).sum(dim=1).mean()


def nearest_pixels(points: np.ndarray, shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """(V,) rows and columns of a picture (H, W) in which image coordinates (V, 2) lie; at its border those outside."""
    height, width = shape
    column, row = np.clip(np.floor(points).astype(int), 0, [width - 1, height - 1]).T
    return row, column


def seen_vertices(seen: Seen) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where a photograph shows the vertices of the fitted head.

    Returns:
        pixels (V, 2) image coordinates, the cosine (V,) between normal and direction to the camera, and (V,) bool
        whether nothing of the head is in front.
    """
    mesh, camera = seen.mesh, seen.camera
    pixels, _ = camera.project(mesh.vertices.astype(np.float64))
    away = camera.position - mesh.vertices
    distance = np.linalg.norm(away, axis=1)
    row, column = nearest_pixels(pixels, seen.image.shape[:2])
    visible = np.abs(seen.raster.depth[row, column] - distance) < DEPTH_UNITS
    return pixels, (mesh.normals * away).sum(axis=1) / distance, visible


def _colours(model: HeadModel, seen: Seen) -> list[_Colours]:
    mesh = seen.mesh
    pixels, cosine, visible = seen_vertices(seen)
    visible &= cosine > FACING
    row, column = nearest_pixels(pixels, seen.image.shape[:2])
    on_skin = np.zeros(len(mesh.vertices), bool)
    on_skin[mesh.part_faces(FACE)] = True
    smooth = cv2.GaussianBlur(seen.image, (0, 0), 0.7).astype(np.float32) / 255.0
    skin, eyes = skin_mask(seen), eye_openings(seen.landmarks, seen.image.shape[:2]) & (seen.raster.parts > 1)
    rng, found = np.random.default_rng(0), []
    for chosen, most, deviation, weight in (
        (visible & on_skin & skin[row, column], MOST_VERTICES, SKIN_DEVIATION, SKIN_WEIGHT),
        (visible & ~on_skin & eyes[row, column], MOST_EYE_VERTICES, EYE_DEVIATION, EYE_WEIGHT),
    ):
        vertices = rng.permutation(np.flatnonzero(chosen))[:most]
        if len(vertices) == 0:
            continue
        at = (pixels[vertices] - 0.5).astype(np.float32)
        observed = cv2.remap(smooth, at[:, :1], at[:, 1:], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)[:, 0]
        lit = LitVertices.of(model, vertices, mesh.occlusion)
        found.append(_Colours(double(observed), double(mesh.normals[vertices]), lit, deviation, weight))
    return found


def fit_appearance(
    model: HeadModel, photographs: Sequence[Seen], texture: np.ndarray | None = None
) -> tuple[np.ndarray, list[np.ndarray]]:
    """Texture code (T,) of a person and light codes (27,), one for each photograph.

    Args:
        model: The head model.
        photographs: Of one person, with the fitted head.
        texture: (T,) where it is known and only the light is fitted.
    """
    priors = LookPriors.of(model)
    colours, size = [_colours(model, seen) for seen in photographs], len(priors.texture_mean)

    def both(flat: np.ndarray) -> tuple[float, np.ndarray]:
        leaf = double(flat).requires_grad_(True)
        looks, lights = leaf[:size], leaf[size:].reshape(len(colours), -1)
        cost = priors.cost(looks, lights)
        for light, parts in zip(lights, colours, strict=True):
            for part in parts:
                cost = cost + part.cost(looks, light)
        (gradient,) = torch.autograd.grad(cost, leaf)
        return cost.item(), gradient.numpy()

    mean, light_mean = priors.texture_mean.numpy(), priors.light_mean.numpy()
    start = np.concatenate([mean if texture is None else texture, np.tile(light_mean, len(colours))])
    free: tuple[float | None, float | None] = (None, None)
    held = [free] * size if texture is None else [(value, value) for value in texture]
    bounds = held + [free] * (len(start) - size)
    options = {"maxiter": 200, "maxcor": 30, "ftol": 1e-7}
    found = minimize(both, start, jac=True, bounds=bounds, method="L-BFGS-B", options=options)
    return found.x[:size], list(found.x[size:].reshape(len(colours), -1))
