"""The visible eye of a photograph taken apart so that it can be turned: white, iris and highlight.

In linear light, and between the lids, the picture is `base * iris + highlight`:

- `base` is the eye's white with its shading. It stays where it is and moves with the lids, whose shadow it carries; the
  part behind the iris is the harmonic continuation of the white that is seen.
- `iris` is the colour of the eye relative to the white. It turns with the eyeball and is 1 beyond the limbus. What the
  lids or a highlight hide of it is completed by the mean over its ring, as the iris is nearly rotationally symmetric.
- `highlight` is light that the cornea reflects: it moves with the centre of the cornea's sphere, not with the iris.

What the three leave is kept as long as the eye hardly turns, so that its own gaze gives back the photograph.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from gazenerf.geometry import Camera, Gaze
from gazenerf.head_model.eyes import IRIS_ANGLE
from gazenerf.head_model.lids import smoothstep
from gazenerf.photographs.eyeball import Eyeball, sample, turned_back
from gazenerf.photographs.iris_rings import (
    DARKER,
    LUMINANCE,
    SMALLEST_KNOWN,
    beyond_iris,
    corneal_glint,
    iris_size,
    limbus_fade,
    ring_colours,
    ring_quantiles,
    with_pupil,
)
from gazenerf.photographs.lid_motion import harmonic_fill

BORDER = (0.012, 0.035)
"""Distance from the lids, in distances between the eyes, at which pixels begin to tell the eye's colour and do."""

SHADOW_RANGE, SHADOW_BLUR = (0.2, 1.0), 0.005
"""What the lids' shadow may make of the white, and its smoothing in distances between the eyes."""

SHADOW_TINT = np.array([0.8, 1.05, 1.3])
"""Exponents of that share in red, green and blue: what reaches the eye there comes from skin."""

REST_DEGREES = 3.0
"""What the three layers do not explain fades with the angle by which the eye turns: to 1 / e at this one."""


@dataclass(frozen=True)
class EyeLayers:
    """One eye of a photograph, taken apart; arrays are those of a window of the picture, linear light.

    Attributes:
        camera: Of the window.
        eyeball: Moved so that its iris is where the picture shows it at `gaze`.
        gaze: At which the picture was taken.
        iris_angle: Radians from the optical axis to the limbus.
        fade: Shares of it between which the iris fades into the white.
        opening: (H, W) share of each pixel between the lids.
        base, highlight: (H, W, 3).
        iris: (H, W, 3) relative colour of the iris, times
        known: (H, W) how far the pixel tells it.
        rings: (R, 3) mean relative colour at `RINGS` times `iris_angle`.
        filled: (H, W) where `base` is the continuation.
        rest: (H, W, 3) what the layers leave.
    """

    camera: Camera
    eyeball: Eyeball
    gaze: Gaze
    iris_angle: float
    fade: tuple[float, float]
    opening: np.ndarray
    base: np.ndarray
    highlight: np.ndarray
    iris: np.ndarray
    known: np.ndarray
    rings: np.ndarray
    filled: np.ndarray
    rest: np.ndarray

    def drawn(self, gaze: Gaze, motion: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The eye at another gaze.

        Args:
            gaze: Head frame.
            motion: (H, W, 2) of the lids; see `lid_motion`.

        Returns:
            (H, W, 3) linear light; (H, W) share between the lids; (H, W) share that was not seen in the photograph.
        """
        back = self.camera.pixel_centres() + motion
        base, opening, filled = (
            sample(layer, back, cv2.INTER_LINEAR) for layer in (self.base, self.opening, self.filled)
        )
        directions = self.eyeball.directions(self.camera)
        angle = np.arccos(np.clip(directions @ gaze.vector(), -1.0, 1.0))
        source = turned_back(directions, self.gaze, gaze)
        at = self.eyeball.project(source, self.camera)
        facing = smoothstep(0.1, 0.3, np.nan_to_num(self.eyeball.facing(source, self.camera), nan=-1.0))
        known = sample(self.known, at, cv2.INTER_LINEAR) * facing
        iris = sample(self.iris, at) * facing[..., None]
        iris = iris + (1.0 - known)[..., None] * ring_colours(angle / self.iris_angle, self.rings)
        beyond = beyond_iris(angle / self.iris_angle, self.fade)
        iris = iris + beyond[..., None] * (1.0 - iris)
        shift = self.eyeball.glint_motion(self.gaze, gaze, self.camera)
        highlight = sample(self.highlight, self.camera.pixel_centres() - shift) * (1.0 - beyond)[..., None]
        kept = np.exp(-((np.rad2deg(self.gaze.angle_to(gaze)) / REST_DEGREES) ** 2))
        unseen = (1.0 - kept) * (filled * beyond + (1.0 - known) * (1.0 - beyond))
        rest = kept * sample(self.rest, back)
        return np.maximum(base * iris + highlight + rest, 0.0), np.clip(opening, 0.0, 1.0), np.clip(unseen, 0.0, 1.0)


def take_apart(
    linear: np.ndarray, opening: np.ndarray, camera: Camera, eyeball: Eyeball, gaze: Gaze, unit: float, factor: int
) -> EyeLayers:
    """Take an eye apart.

    Args:
        linear: (H, W, 3) window of the photograph, linear light.
        opening: (H, W) share of each pixel between the lids.
        camera: Of the window.
        eyeball, gaze: As the window shows them.
        unit: Distance between the eyes, pixels.
        factor: How many times the photograph was enlarged.
    """
    inside = opening > 0.5
    depth = cv2.distanceTransform(inside.astype(np.uint8), cv2.DIST_L2, 5)
    certain = smoothstep(BORDER[0] * unit, BORDER[1] * unit, depth)
    angle = np.arccos(np.clip(eyeball.directions(camera) @ gaze.vector(), -1.0, 1.0))
    size = iris_size(linear @ LUMINANCE, certain > 0.5, angle) * IRIS_ANGLE
    share = angle / size
    fade = limbus_fade(eyeball.radius_px(camera) * np.sin(size) / factor)
    on_iris = 1.0 - beyond_iris(share, fade)
    grown = np.ones((3, 3), np.uint8)
    domain = cv2.dilate(inside.astype(np.uint8), grown, iterations=max(1, round(0.02 * unit))) > 0
    surely_white = (certain > 0.5) & (on_iris == 0.0)
    if surely_white.any():
        bright = linear @ LUMINANCE > np.median(linear[surely_white] @ LUMINANCE)
        surely_white |= (certain > 0.5) & (share > fade[0]) & bright
    white = continued_white(linear, domain, surely_white, unit)
    relative = np.clip(linear / np.maximum(white, 1e-3), 0.0, 2.0)
    relative = np.where((share > 1.0)[..., None], np.minimum(relative, 1.0), relative)
    darker = ring_colours(share, ring_quantiles(relative, share, certain, DARKER))
    glint = corneal_glint(relative, darker, share, certain, unit)
    rings = ring_quantiles(relative, share, certain * (1.0 - glint), 0.5)
    rings = with_pupil(rings, relative, share, certain, glint)
    expected = ring_colours(share, rings)
    highlight = np.maximum(linear - white * expected, 0.0) * glint[..., None]
    known = certain * (1.0 - glint)
    iris = expected + known[..., None] * (relative - expected)
    shown = iris + (1.0 - on_iris)[..., None] * (1.0 - iris)
    base = np.where((on_iris > 0.0)[..., None], white * _shadow(linear, white * shown, certain, unit), linear)
    layers = EyeLayers(
        camera, eyeball, gaze, float(size), fade, opening, base, highlight, relative * known[..., None], known, rings,
        on_iris * inside, np.zeros_like(linear),
    )  # fmt: skip
    drawn, between_lids, _ = layers.drawn(gaze, np.zeros((*linear.shape[:2], 2)))
    return replace(layers, rest=np.where(between_lids[..., None] > 0.0, linear - drawn, 0.0))


def _shadow(linear: np.ndarray, lit: np.ndarray, certain: np.ndarray, unit: float) -> np.ndarray:
    """(H, W, 3) share of light that lashes and lids leave near the border of the opening."""
    ratio = (linear @ LUMINANCE) / np.maximum(lit @ LUMINANCE, 0.01)
    shadow = 1.0 + (1.0 - certain) * (np.clip(ratio, *SHADOW_RANGE) - 1.0)
    return cv2.GaussianBlur(shadow, (0, 0), max(0.5, SHADOW_BLUR * unit))[..., None] ** SHADOW_TINT


def continued_white(linear: np.ndarray, domain: np.ndarray, known: np.ndarray, unit: float) -> np.ndarray:
    """(H, W, 3) the eye's white over a domain, continued from where it is known (H, W)."""
    smooth = cv2.GaussianBlur(np.where(known[..., None], linear, 0.0), (0, 0), max(0.7, 0.008 * unit))
    weight = cv2.GaussianBlur(known.astype(np.float64), (0, 0), max(0.7, 0.008 * unit))
    smooth = smooth / np.maximum(weight, 1e-6)[..., None]
    bright = np.quantile(linear[domain] @ LUMINANCE, 0.9) if domain.any() else 1.0
    white = np.full(linear.shape, bright)
    if known.sum() < SMALLEST_KNOWN:
        return white
    filled = harmonic_fill(smooth, known, domain)
    return np.where((filled > 0.0).all(axis=-1, keepdims=True), filled, np.median(linear[known], axis=0))
