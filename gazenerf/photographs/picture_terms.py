"""One picture's terms of the 3DMM fit: its camera, what is observed in it, and the cost of missing that."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
import torch
import torch.nn.functional as F

from gazenerf.geometry import Camera
from gazenerf.head_model.generic import METRES_PER_UNIT
from gazenerf.head_model.points import double
from gazenerf.photographs.correspondence import LandmarkTable, pose_features
from gazenerf.photographs.landmarks import FaceLandmarks
from gazenerf.photographs.lit_skin import LitSkin

DISTANCE_M, DISTANCE_DEVIATION = 1.1, 0.35
"""Median of the distance from which people are photographed, and the standard deviation of its logarithm."""

ROBUST = 3.0
"""Landmark residuals grow linearly from this many deviations on."""

OPENING_MM = 0.35
"""Standard deviation, on each axis, of the middle of an opening found in pixels."""

ROBUST_GAZE = 2.0
"""Deviations from which on a gaze that a network reads counts less and less: now and then it is far off."""

SKIN_WEIGHT = 2000.0
"""How many independent pixels all vertices together count as where the head misses no more than `LEAST_DEVIATION`."""

LEAST_DEVIATION, FEWER = 0.02, 2.0
"""sRGB: what a pixel of skin may miss at least; and the power of this over what it may miss by which the count of
pixels falls: what a head model cannot draw, it misses alike over much of a face."""

MM_PER_UNIT = 1000.0 * METRES_PER_UNIT

UNITS_AHEAD = 2.0
"""The camera stays at least this far from the head's origin, world units."""


@dataclass(frozen=True)
class IrisPoints:
    """Where the irises of one picture are.

    Attributes:
        pixels: (2, 2) the subject's left first; NaN where unknown.
        spread_mm: Standard deviation on each axis.
        reach: Distance of these points from the eyeballs' centres, in radii.
    """

    pixels: np.ndarray
    spread_mm: float
    reach: float


@dataclass(frozen=True)
class SeenOpenings:
    """Where the openings of the eyes are by the pixels, told as the middles of the lids' fitted vertices.

    Attributes:
        rows: For the left and the right eye, the numbers of the table's landmarks about its opening.
        middles: (2, 2) where their vertices' mean is to be seen, pixels; NaN where the pixels do not tell.
    """

    rows: tuple[tuple[int, ...], tuple[int, ...]]
    middles: np.ndarray


@dataclass(frozen=True)
class SeenGaze:
    """The gaze as a network reads it from the look of eyes and face, whatever their geometry.

    Attributes:
        pitch, yaw: Radians, head frame.
        deviations: (2,) of pitch and yaw, radians.
    """

    pitch: float
    yaw: float
    deviations: tuple[float, float]


@dataclass(frozen=True)
class SeenSkin:
    """Pixels of the skin that the fitted head is to lie over.

    Attributes:
        skin: N vertices of it.
        texture, light: (T,) and (27,) codes that it was drawn with.
        colours: (N, 3) sRGB from 0 to 1, as it was drawn, blurred like `picture`.
        picture: (1, 3, H, W) float64 the part of the photograph around the face, blurred.
        to_picture: (2, 2) factor and shift per axis from the photograph's pixels to those of `picture`.
        deviation: sRGB, what a colour may miss.
    """

    skin: LitSkin
    texture: np.ndarray
    light: np.ndarray
    colours: torch.Tensor
    picture: torch.Tensor
    to_picture: np.ndarray
    deviation: float

    def lit(self, places: torch.Tensor, texture: torch.Tensor, light: torch.Tensor) -> torch.Tensor:
        """(N, 3) sRGB from 0 to 1 of the vertices, blurred like `picture`, at other places, texture and light.

        How they change is told of the vertices themselves: blur goes over little of a face.

        Args:
            places: (3, N, 3) of `skin.vertices`.
            texture, light: (T,) and (27,).
        """
        return self.colours + self.skin.colours(places, texture, light) - self._before

    @cached_property
    def _before(self) -> torch.Tensor:
        """(N, 3) the vertices' own colours as they were drawn."""
        return self.skin.lit.colours(self.skin.drawn_normals, double(self.texture), double(self.light))

    def cost(self, pixels: torch.Tensor, colours: torch.Tensor) -> torch.Tensor:
        """Robust squares of how far colours (N, 3) are from those of the photograph's pixels (N, 2) they lie on."""
        factor, shift = double(self.to_picture)
        height, width = self.picture.shape[2:]
        at = 2.0 * (pixels * factor + shift) / double([width, height]) - 1.0
        seen = F.grid_sample(self.picture, at[None, None], mode="bilinear", padding_mode="border", align_corners=False)
        miss = (seen[0, :, 0].T - colours) / self.deviation
        count = SKIN_WEIGHT * (LEAST_DEVIATION / self.deviation) ** FEWER
        return count * ((1.0 + miss.square()).sqrt() - 1.0).sum(dim=1).mean()


@dataclass(frozen=True)
class Observed:
    """What is fitted in one picture.

    Attributes:
        landmarks: Pixels.
        size: (width, height) of the picture.
        irises: Found otherwise than by the landmark detector; None where they were not.
        focal: Pixels, where it is known.
        teeth_shut: Teeth fill what the lips leave open, so the jaw is shut.
        openings: Of the eyes; None where nobody looked.
        gaze: As a network reads it; None where nobody asked one.
        skin: Pixels that the fitted head is to lie over; None where they are not compared.
    """

    landmarks: FaceLandmarks
    size: tuple[int, int]
    irises: IrisPoints | None = None
    focal: float | None = None
    teeth_shut: bool = False
    openings: SeenOpenings | None = None
    gaze: SeenGaze | None = None
    skin: SeenSkin | None = None

    def with_eyes(self, irises: IrisPoints | None, openings: SeenOpenings | None, gaze: SeenGaze | None) -> Observed:
        """The same picture with what its eyes tell."""
        return replace(self, irises=irises, openings=openings, gaze=gaze)


@dataclass(frozen=True)
class PictureParameters:
    """Parameters of one picture.

    Attributes:
        rotation: (3,) rotation vector on top of the start's rotation.
        place: (2,) of the head's origin in the picture, in picture sides from where it started.
        scale: Logarithm of pixels per world unit at the origin, from where it started.
        distance: Logarithm of the distance of the origin along the camera's axis, world units.
        gaze, expression, errors: (2,) radians, (E,), (C,) amounts of the table's error components.
    """

    rotation: torch.Tensor
    place: torch.Tensor
    scale: torch.Tensor
    distance: torch.Tensor
    gaze: torch.Tensor
    expression: torch.Tensor
    errors: torch.Tensor


class PictureTerms:
    """The terms of one picture."""

    def __init__(self, observed: Observed, table: LandmarkTable, eye_radius: float) -> None:
        self.observed, self._eye_radius, self._table = observed, eye_radius, table
        width, height = observed.size
        self._middle, self._side = np.array([width / 2.0, height / 2.0]), float(max(width, height))
        self._marks = double(observed.landmarks.points[table.landmarks])
        self._axes = double(observed.landmarks.eye_axes)
        self._offset, self._slopes = double(table.offset_mm), double(table.slopes_mm)
        self._components, self._skin = double(table.components_mm), len(table.vertices)
        self._noise = double(table.noise_mm)
        self._rotation = np.eye(3)
        self._place, self._scale = np.zeros(2), 1.0
        self.pixels_per_mm = observed.landmarks.interocular / 63.0

    def start(self, mean: np.ndarray) -> np.ndarray:
        """(7,) rotation, place, scale and distance that turn points (L, 3) to the landmarks."""
        distance = DISTANCE_M / METRES_PER_UNIT
        focal = self.observed.focal or self.observed.landmarks.interocular / 0.63 * distance
        intrinsics = np.array([[focal, 0.0, self._middle[0]], [0.0, focal, self._middle[1]], [0.0, 0.0, 1.0]])
        flipped = mean * [1.0, -1.0, -1.0]  # the solver prefers points in front of a camera that looks along +z
        marks = self._marks[: self._skin].numpy()
        _, rotation, move = cv2.solvePnP(flipped, marks, intrinsics, None, flags=cv2.SOLVEPNP_SQPNP)
        z = max(float(move[2, 0]), UNITS_AHEAD)
        self._rotation = cv2.Rodrigues(rotation)[0] @ np.diag([1.0, -1.0, -1.0])
        self._place = self._middle + focal * move[:2, 0] / z
        self._scale = focal / z
        return np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, np.log(z)])

    def from_camera(self, camera: Camera, eyes: np.ndarray) -> np.ndarray:
        """(7,) the same of a camera; `eyes` are the eyeballs' centres (2, 3)."""
        pose = camera.camera_from_world
        x, y, z = pose[:3, 3]
        self._rotation, self._scale = pose[:3, :3], camera.fx / z
        self._place = self._middle + camera.fx * np.array([x, y]) / z
        self.pixels_per_mm = camera.fx / float(camera.project(eyes.mean(axis=0))[1]) / MM_PER_UNIT
        return np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, np.log(z)])

    def fix_millimetres(self, picture: PictureParameters, eyes: torch.Tensor) -> None:
        """Fix the pixels in a millimetre at what a fitted pose says of the eyeballs' centres (2, 3)."""
        camera = self.camera(picture)
        self.pixels_per_mm = camera.fx / float(camera.project(eyes.numpy().mean(axis=0))[1]) / MM_PER_UNIT

    def transform(self, picture: PictureParameters) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Rotation (3, 3) and translation (3,) from world to camera, and the focal length."""
        x, y, z = picture.rotation
        none = torch.zeros_like(x)
        cross = torch.stack([none, -z, y, z, none, -x, -y, x, none]).reshape(3, 3)
        rotation = torch.linalg.matrix_exp(cross) @ double(self._rotation)
        depth = picture.distance.exp()
        focal = self._scale * picture.scale.exp() * depth
        place = double(self._place - self._middle) + self._side * picture.place
        return rotation, torch.cat([place * depth / focal, depth[None]]), focal

    def project(self, picture: PictureParameters, points: torch.Tensor) -> torch.Tensor:
        """(N, 2) pixels of world points (N, 3)."""
        rotation, move, focal = self.transform(picture)
        seen = points @ rotation.T + move
        return focal * seen[:, :2] / seen[:, 2:].clamp(min=0.1) + double(self._middle)

    def landmark_cost(self, picture: PictureParameters, points: torch.Tensor, identity: torch.Tensor) -> torch.Tensor:
        """Robust squares of the landmarks' residuals in units of their noise."""
        miss = self.unexplained(picture, points, identity)
        square = (miss / self._noise[:, None]).square().sum(dim=1) / ROBUST**2
        return (2.0 * ROBUST**2 * ((1.0 + square).sqrt() - 1.0)).sum()

    def unexplained(self, picture: PictureParameters, points: torch.Tensor, identity: torch.Tensor) -> torch.Tensor:
        """(L, 2) mm: residuals less what detectors miss of such a face, and the error components."""
        miss = (self._marks - self.project(picture, points)) @ self._axes.T / self.pixels_per_mm
        rotation, move, _ = self.transform(picture)
        about = torch.cat([pose_features(-rotation.T @ move, picture.gaze), identity])
        return miss - self._offset - torch.tensordot(about, self._slopes, 1) - torch.tensordot(
            picture.errors, self._components, 1
        )  # fmt: skip

    def iris_cost(self, picture: PictureParameters, centres: torch.Tensor) -> torch.Tensor:
        """Squares of the irises' residuals in units of their deviation."""
        irises = self.observed.irises
        if irises is None or not np.isfinite(irises.pixels).any():
            return torch.zeros((), dtype=torch.float64)
        direction = gaze_direction(picture.gaze)
        seen = np.flatnonzero(np.isfinite(irises.pixels).all(axis=1))
        places = self.project(picture, centres + self._eye_radius * irises.reach * direction)[seen]
        miss = (double(irises.pixels[seen]) - places) / self.pixels_per_mm
        return (miss / irises.spread_mm).square().sum()

    def openings_cost(self, picture: PictureParameters, points: torch.Tensor) -> torch.Tensor:
        """Squares of how far the middles of the lids lie from the openings that are seen, over their deviation."""
        openings, total = self.observed.openings, torch.zeros((), dtype=torch.float64)
        if openings is None:
            return total
        for rows, middle in zip(openings.rows, openings.middles, strict=True):
            if rows and np.isfinite(middle).all():
                miss = self.project(picture, points[list(rows)]).mean(dim=0) - double(middle)
                total = total + (miss / self.pixels_per_mm / OPENING_MM).square().sum()
        return total

    def gaze_cost(self, picture: PictureParameters) -> torch.Tensor:
        """How far the gaze is from what a network reads, in units of the reading's deviations; Cauchy's cost."""
        seen = self.observed.gaze
        if seen is None:
            return torch.zeros((), dtype=torch.float64)
        miss = (picture.gaze - double(np.array([seen.pitch, seen.yaw]))) / double(np.array(seen.deviations))
        return ROBUST_GAZE**2 * (miss.square().sum() / ROBUST_GAZE**2).log1p()

    def skin_cost(
        self, picture: PictureParameters, places: torch.Tensor, texture: torch.Tensor, light: torch.Tensor
    ) -> torch.Tensor:
        """Robust squares of how far colours of the skin's vertices are from those of their pixels.

        Args:
            picture: Where they are seen.
            places: (3, N, 3) of `LitSkin.vertices`.
            texture, light: (T,) and (27,) that they are seen with.
        """
        seen = self.observed.skin
        assert seen is not None
        return seen.cost(self.project(picture, places[0]), seen.lit(places, texture, light))

    def distance_cost(self, picture: PictureParameters) -> torch.Tensor:
        """Squares of the distance's and, where it is known, the focal length's deviation from what is expected."""
        off = (picture.distance - np.log(DISTANCE_M / METRES_PER_UNIT)) / DISTANCE_DEVIATION
        if self.observed.focal is None:
            return off.square()
        return off.square() + ((self.transform(picture)[2] / self.observed.focal).log() / 0.01).square()

    def camera(self, picture: PictureParameters) -> Camera:
        """The camera, whose world is the head's frame."""
        rotation, move, focal = (part.numpy() for part in self.transform(picture))
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = rotation.T, -rotation.T @ move
        width, height = self.observed.size
        return Camera(float(focal), float(focal), width / 2.0, height / 2.0, width, height, pose)


def gaze_direction(gaze: torch.Tensor) -> torch.Tensor:
    """(3,) unit vector of a gaze (2,), pitch and yaw in radians."""
    pitch, yaw = gaze
    return torch.stack([pitch.cos() * yaw.sin(), pitch.sin(), pitch.cos() * yaw.cos()])
