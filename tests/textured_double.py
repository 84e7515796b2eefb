"""The analytic head painted with a solid texture that features can be found on."""

from __future__ import annotations

import numpy as np

from gazenerf.geometry import Camera
from gazenerf.heads.analytic import AnalyticField
from gazenerf.heads.interface import Part, RenderedView


class TexturedField(AnalyticField):
    """Each point of the surface has one colour, the same from everywhere, with detail at several scales.

    Args:
        glued: The texture sticks to the screen instead.
        faults: Arguments of `AnalyticField`.
    """

    def __init__(self, *, glued: bool = False, **faults) -> None:
        super().__init__(**faults)
        self.glued = glued
        rng = np.random.default_rng(5)
        self._waves = rng.normal(size=(40, 3)) * rng.uniform(6.0, 30.0, (40, 1))
        self._phases = rng.uniform(0.0, 2.0 * np.pi, 40)

    def render(self, camera: Camera, parts: tuple[Part, ...] = ("head",)) -> RenderedView:
        """See `BoundField`."""
        distance, points, _ = self._hit(camera, "head")
        if self.glued:
            pixels = camera.pixel_centres() / camera.width * 2.6
            points = np.concatenate([pixels, np.ones_like(pixels[..., :1])], axis=-1)
        waves = np.sin(points @ self._waves.T + self._phases)
        grey = np.clip(0.5 + 0.07 * waves.sum(axis=-1), 0.0, 1.0)
        image = np.where(np.isfinite(distance), grey, 0.0)[..., None].repeat(3, axis=-1).astype(np.float32)
        return RenderedView(camera, dict.fromkeys(parts, image), {})
