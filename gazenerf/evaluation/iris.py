"""Gaze read from pictures without learning: the iris found in several views and triangulated.

In each view a disc drawn on the known eyeball is fitted to the picture inside the eye opening, which
gives the iris's image point to a fraction of a pixel. The rays of several views meet at the iris, and
the axis from the eyeball's centre to that point is the gaze.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.optimize import minimize

from gazenerf.geometry import Camera, Gaze
from gazenerf.head_model.eyes import IRIS_ANGLE, PUPIL_ANGLE
from gazenerf.head_model.interface import HeadMesh

OPENINGS = {"left": tuple(range(42, 48)), "right": tuple(range(36, 42))}
"""Standard landmarks around each eye opening; left is the subject's."""

MIN_PIXELS = 24
"""An eye opening with fewer pixels is not read."""

MIN_CONTRAST = 0.35
"""Share of the opening's variance that the fitted disc must explain."""

MIN_SHOWN = 0.35
"""Share of the fitted disc that must lie inside the opening."""

WINDOW_MARGIN = 4
"""Steps around the openings in `openings_window`: what the neural renderer's blurs bring in from beside comes from less
than two feature pixels away."""

REACH = np.deg2rad(50.0)
"""The search covers this angle around +Z of the head."""


@dataclass(frozen=True)
class IrisFit:
    """The iris of one eye in one view.

    Attributes:
        pixel: (2,) image point of the iris's centre.
        direction: (3,) unit, from the eyeball's centre, world frame, as this view alone sees it.
        contrast: Share of the variance inside the opening that the disc explains.
    """

    pixel: np.ndarray
    direction: np.ndarray
    contrast: float


@dataclass(frozen=True)
class GazeReading:
    """Gaze of one eye from several views.

    Attributes:
        gaze: From the triangulated iris.
        views: How many views found the iris.
        residual_px: Root mean square distance between the triangulated point and the fits, pixels.
        spread: Radians: root mean square angle between each view's own direction and their mean.
    """

    gaze: Gaze
    views: int
    residual_px: float
    spread: float


def opening_mask(mesh: HeadMesh, eye: str, camera: Camera) -> np.ndarray:
    """(H, W) bool: the pixels between the lids of `left` or `right`."""
    marks = np.stack([mesh.landmarks[str(i)] for i in OPENINGS[eye]])
    pixels, z = camera.project(marks.astype(np.float64))
    mask = np.zeros((camera.height, camera.width), np.uint8)
    if (z > 0).all():
        outline = cv2.convexHull(np.round((pixels - 0.5) * 16.0).astype(np.int32))
        cv2.fillConvexPoly(mask, outline, 1, lineType=cv2.LINE_8, shift=4)
    return mask.astype(bool)


def openings_window(mesh: HeadMesh, camera: Camera, step: int = 1) -> Camera:
    """The camera of the window around both eye openings, `WINDOW_MARGIN` steps wider on every side.

    The iris is read inside the openings only, so a picture of the window tells as much as the whole one.

    Args:
        mesh: Tells where the openings are.
        camera: Of the whole picture.
        step: Pixels; the window begins and ends at multiples of it, such as the pixels of a feature pixel.

    Returns:
        The whole camera where an opening lies behind it, or none in the picture.
    """
    marks = np.stack([mesh.landmarks[str(i)] for indices in OPENINGS.values() for i in indices])
    pixels, z = camera.project(marks.astype(np.float64))
    low = step * np.maximum(np.floor(pixels.min(axis=0) / step).astype(int) - WINDOW_MARGIN, 0)
    high = step * (np.ceil(pixels.max(axis=0) / step).astype(int) + WINDOW_MARGIN)
    high = np.minimum(high, [camera.width, camera.height])
    if not (z > 0).all() or (high - low < 2 * step).any():
        return camera
    return camera.cropped(int(low[0]), int(low[1]), int(high[0] - low[0]), int(high[1] - low[1]))


def fit_iris(image: np.ndarray, mask: np.ndarray, camera: Camera, centre: np.ndarray, radius: float) -> IrisFit | None:
    """Find the iris of an eyeball in a picture.

    The picture inside the mask is explained as a plane (shading) plus a dark iris and a darker pupil
    with soft edges on the eyeball; the direction that explains most is searched for.

    Args:
        image: (H, W, 3) sRGB in [0, 1].
        mask: (H, W) bool, the eye opening.
        camera: Of the picture.
        centre: (3,) of the eyeball, world units.
        radius: Of the eyeball, world units.

    Returns:
        None when the opening is too small or nothing in it looks like an iris.
    """
    pixels = camera.pixel_centres()[mask]
    origins, rays = camera.rays(pixels)
    offset = origins - centre
    b = (offset * rays).sum(-1)
    under = b**2 - ((offset**2).sum(-1) - radius**2)
    hit = under > 0
    if hit.sum() < MIN_PIXELS:
        return None
    outward = (offset[hit] + (-b[hit] - np.sqrt(under[hit]))[:, None] * rays[hit]) / radius
    grey = image[mask][hit].astype(np.float64) @ np.array([0.3, 0.5, 0.2])
    grey = np.minimum(grey, np.percentile(grey, 92))
    place = pixels[hit] - pixels[hit].mean(0)
    flat = np.column_stack([np.ones(len(grey)), place / np.maximum(np.abs(place).max(0), 1e-9)])
    basis, _ = np.linalg.qr(flat)
    rest = grey - basis @ (basis.T @ grey)
    total = float(rest @ rest)
    if total < 1e-8:
        return None
    distance = float(np.linalg.norm(centre - camera.position))
    edge = max(0.04, 0.45 * distance / camera.fx / radius)
    areas = 1.0 / np.maximum(0.15, -(outward * rays[hit]).sum(-1))
    pixel_angle = (distance / camera.fx / radius) ** 2
    whole = np.pi * np.sin(IRIS_ANGLE) ** 2

    def explained(angles: np.ndarray) -> float:
        axis = Gaze(float(angles[0]), float(angles[1])).vector()
        away = np.arccos(np.clip(outward @ axis, -1.0, 1.0))
        iris = 1.0 / (1.0 + np.exp(np.clip((away - IRIS_ANGLE) / (0.5 * edge), -40, 40)))
        pupil = 1.0 / (1.0 + np.exp(np.clip((away - PUPIL_ANGLE) / (0.5 * edge), -40, 40)))
        if (iris * areas).sum() * pixel_angle < MIN_SHOWN * whole:
            return 0.0
        shapes = iris + 0.35 * pupil
        shapes = shapes - basis @ (basis.T @ shapes)
        power = float(shapes @ shapes)
        along = float(shapes @ rest)
        if along >= 0.0 or power < 1e-9:
            return 0.0
        return along**2 / (power * total)

    grid = np.linspace(-REACH, REACH, 26)
    candidates = [(explained(np.array([pitch, yaw])), pitch, yaw) for pitch in grid * 0.8 for yaw in grid]
    best = max(candidates)
    if best[0] <= 0.0:
        return None
    result = minimize(
        lambda angles: -explained(angles),
        np.array(best[1:]),
        method="Nelder-Mead",
        options={"initial_simplex": np.array(best[1:]) + np.array([[0, 0], [0.04, 0], [0, 0.04]]), "xatol": 1e-4},
    )
    contrast = -float(result.fun)
    if contrast < MIN_CONTRAST:
        return None
    direction = Gaze(float(result.x[0]), float(result.x[1])).vector()
    pixel, _ = camera.project(centre + radius * direction)
    return IrisFit(pixel, direction, contrast)


def triangulate(pixels: Sequence[np.ndarray], cameras: Sequence[Camera]) -> np.ndarray:
    """(3,) world point nearest to the rays through image points (2,) of at least two cameras.

    Raises:
        ValueError: fewer than two rays, or all parallel.
    """
    if len(pixels) < 2 or len(pixels) != len(cameras):
        raise ValueError(f"triangulation needs two or more views, got {len(pixels)} points, {len(cameras)} cameras")
    normal, right = np.zeros((3, 3)), np.zeros(3)
    for pixel, camera in zip(pixels, cameras, strict=True):
        origin, ray = camera.rays(np.asarray(pixel)[None])
        across = np.eye(3) - np.outer(ray[0], ray[0])
        normal += across
        right += across @ origin[0]
    if np.linalg.cond(normal) > 1e8:
        raise ValueError("the rays are parallel")
    return np.linalg.solve(normal, right)


def iris_gaze(pictures: Sequence[tuple[np.ndarray, Camera]], mesh: HeadMesh) -> dict[str, GazeReading]:
    """Gaze of each eye from pictures of one head at one gaze.

    Args:
        pictures: sRGB pictures (H, W, 3) in [0, 1] and their cameras; the iris is read to about a
            fifth of a pixel, so the larger the better.
        mesh: Tells where the eyeballs and the lids are. Its iris is not looked at.

    Returns:
        `left` and `right` (the subject's), those found in at least two views.
    """
    found: dict[str, GazeReading] = {}
    for number, eye in enumerate(("left", "right")):
        centre = np.asarray(mesh.eye_centres[number], dtype=np.float64)
        fits, cameras = [], []
        for image, camera in pictures:
            fit = fit_iris(image, opening_mask(mesh, eye, camera), camera, centre, mesh.eye_radius)
            if fit is not None:
                fits.append(fit)
                cameras.append(camera)
        if len(fits) < 2:
            continue
        directions = np.stack([fit.direction for fit in fits])
        mean = directions.mean(0) / np.linalg.norm(directions.mean(0))
        agrees = directions @ mean > np.cos(np.deg2rad(15.0))
        if agrees.sum() < 2:
            continue
        fits = [fit for fit, keep in zip(fits, agrees, strict=True) if keep]
        cameras = [camera for camera, keep in zip(cameras, agrees, strict=True) if keep]
        point = triangulate([fit.pixel for fit in fits], cameras)
        misses = [camera.project(point)[0] - fit.pixel for fit, camera in zip(fits, cameras, strict=True)]
        gap = np.arccos(np.clip(directions[agrees] @ mean, -1.0, 1.0))
        found[eye] = GazeReading(
            Gaze.from_vector(point - centre),
            len(fits),
            float(np.sqrt(np.mean(np.sum(np.square(misses), axis=-1)))),
            float(np.sqrt(np.mean(gap**2))),
        )
    return found


def iris_cameras(size: int, yaws: Sequence[float] = (-24.0, -12.0, 0.0, 12.0, 24.0)) -> list[Camera]:
    """Cameras at neutral distance from which the iris is read; yaw in degrees, two heights."""
    heights = (0.0, 8.0)
    return [
        Camera.orbit(float(np.deg2rad(yaw)), float(np.deg2rad(heights[i % 2])), size=size) for i, yaw in enumerate(yaws)
    ]


def measure_gaze(render: Callable[[Camera], np.ndarray], mesh: HeadMesh, size: int = 256) -> dict[str, GazeReading]:
    """`iris_gaze` of whatever renders pictures (H, W, 3) in [0, 1] from `iris_cameras`."""
    return iris_gaze([(render(camera), camera) for camera in iris_cameras(size)], mesh)
