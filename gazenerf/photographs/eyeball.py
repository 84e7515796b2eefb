"""An eyeball as a picture shows it: directions on its sphere, and where the reflection of a lamp lies on its cornea."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from gazenerf.geometry import Camera, Gaze
from gazenerf.head_model.eyes import CORNEA_AHEAD


@dataclass(frozen=True)
class KnownEyes:
    """What other frames of a video tell of the eyes in one of them.

    Attributes:
        offsets: (2, 3) from the fitted eyeballs' centres to the true ones, left first, world units.
        irises: (2, 2) where the picture shows the centres of the irises' discs, pixels; NaN where it does not.
    """

    offsets: np.ndarray
    irises: np.ndarray


@dataclass(frozen=True)
class Eyeball:
    """A sphere that turns about its centre.

    Attributes:
        centre: (3,) world units.
        radius: World units.
    """

    centre: np.ndarray
    radius: float

    def directions(self, camera: Camera) -> np.ndarray:
        """(H, W, 3) unit vectors from the centre to what each pixel's ray hits first; NaN where it misses."""
        rays_o, rays_d = camera.rays()
        offset = rays_o - self.centre
        along = (offset * rays_d).sum(axis=-1)
        under = along**2 - ((offset**2).sum(axis=-1) - self.radius**2)
        hit = np.where(under > 0.0, -along - np.sqrt(np.maximum(under, 0.0)), np.nan)
        return (offset + hit[..., None] * rays_d) / self.radius

    def project(self, directions: np.ndarray, camera: Camera) -> np.ndarray:
        """(..., 2) pixels of the points of the sphere in unit directions (..., 3)."""
        return camera.project(self.centre + self.radius * directions)[0]

    def facing(self, directions: np.ndarray, camera: Camera) -> np.ndarray:
        """(...) cosine between the normal in directions (..., 3) and the way to the camera."""
        away = camera.position - self.centre - self.radius * directions
        return (directions * away).sum(axis=-1) / np.linalg.norm(away, axis=-1)

    def radius_px(self, camera: Camera) -> float:
        """The eyeball's radius in pixels."""
        return camera.fx * self.radius / float(camera.project(self.centre)[1])

    def moved_in_picture(self, pixels: np.ndarray, camera: Camera) -> Eyeball:
        """The same eyeball moved parallel to the picture plane by (2,) pixels at its depth."""
        _, z = camera.project(self.centre)
        step = np.array([pixels[0] / camera.fx, pixels[1] / camera.fy, 0.0]) * float(z)
        return Eyeball(self.centre + camera.world_from_camera[:3, :3] @ step, self.radius)

    def towards(self, pixel: np.ndarray, camera: Camera, reach: float) -> Gaze | None:
        """The gaze at which a picture shows the point of the optical axis that lies `reach` radii from the centre.

        Args:
            pixel: (2,) where it is shown; NaN where that is unknown.
            camera: Of the picture.
            reach: Radii.

        Returns:
            None where it cannot be there.
        """
        if not np.isfinite(pixel).all():
            return None
        origins, rays = camera.rays(pixel[None])
        offset = origins[0] - self.centre
        along = float(offset @ rays[0])
        under = along**2 - (float(offset @ offset) - (reach * self.radius) ** 2)
        return Gaze.from_vector(offset + (-along - np.sqrt(under)) * rays[0]) if under > 0.0 else None

    def glint_motion(self, source: Gaze, target: Gaze, camera: Camera) -> np.ndarray:
        """(2,) pixels by which the reflection of a distant lamp moves in the picture.

        It lies where the cornea's normal halves the angle between lamp and camera, at the same place of the cornea's
        sphere whichever way the eye looks; so it moves as that sphere's centre does, about 0.4 as far as the iris.
        """
        centres = np.stack([self.centre + CORNEA_AHEAD * self.radius * g.vector() for g in (source, target)])
        before, after = camera.project(centres)[0]
        return after - before


def turned_back(directions: np.ndarray, source: Gaze, target: Gaze) -> np.ndarray:
    """(..., 3) where points of an eyeball at the target gaze, in directions (..., 3), were at the source gaze."""
    return directions @ (source.rotation() @ target.rotation().T).T


def sample(image: np.ndarray, pixels: np.ndarray, how: int = cv2.INTER_CUBIC) -> np.ndarray:
    """Picture (H, W[, C]) at image coordinates (H', W', 2); its border is repeated."""
    at = np.nan_to_num(pixels - 0.5, nan=-1e4).astype(np.float32)
    return cv2.remap(image.astype(np.float32), at[..., 0], at[..., 1], how, borderMode=cv2.BORDER_REPLICATE)
