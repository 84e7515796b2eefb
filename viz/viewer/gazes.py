"""Where the eyes look, as a visitor of the viewer chooses it."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from gazenerf.geometry import Camera, Gaze
from gazenerf.geometry.paths import GazeRange, gaze_circle, gaze_sweep, look_at_camera

MODES = {
    "hold": "held by the sliders",
    "look-at-camera": "look at me",
    "look-at-point": "look at the point",
    "sweep": "sweep",
    "circle": "circle",
}
"""What the eyes can do, and what the page calls it."""

PLAYED = ("sweep", "circle")
"""Modes that move on their own."""

PERIOD, FRAMES = 6.0, 240
"""Seconds and steps of one round of a played mode."""


@dataclass(frozen=True)
class GazeChoice:
    """What the eyes do.

    Attributes:
        mode: A name of `MODES`.
        gaze: Where they look in `hold`, head frame.
        point: (x, y, z) that they look at in `look-at-point`, world units.
    """

    mode: str = "hold"
    gaze: Gaze = field(default_factory=Gaze)
    point: tuple[float, float, float] = (0.0, 0.0, 6.0)

    def __post_init__(self) -> None:
        """Raise ValueError for an unknown mode or numbers that are not finite."""
        if self.mode not in MODES:
            raise ValueError(f"unknown gaze mode {self.mode!r}; there are {', '.join(MODES)}")
        if not np.isfinite([self.gaze.pitch, self.gaze.yaw, *self.point]).all():
            raise ValueError("a gaze and a point must be finite")

    @property
    def plays(self) -> bool:
        """Whether the eyes move on their own."""
        return self.mode in PLAYED

    def at(self, camera: Camera, seconds: float, limits: GazeRange, eyes: np.ndarray) -> Gaze:
        """The gaze (head frame) of one picture.

        Args:
            camera: Of the picture; each visitor is looked at from where they are.
            seconds: Of any clock, for the played modes.
            limits: The trained range; all modes but `hold` stay inside.
            eyes: (3,) middle between the eyes, world units.
        """
        if self.mode == "look-at-camera":
            return look_at_camera([camera], limits, eyes)[0]
        if self.mode == "look-at-point":
            toward = np.asarray(self.point) - eyes
            return limits.clip(Gaze.from_vector(toward)) if np.linalg.norm(toward) > 1e-6 else Gaze()
        if self.plays:
            path = _round(self.mode, limits)
            return path[int(seconds / PERIOD * FRAMES) % FRAMES]
        return self.gaze


@lru_cache(maxsize=8)
def _round(mode: str, limits: GazeRange) -> list[Gaze]:
    return (gaze_sweep if mode == "sweep" else gaze_circle)(FRAMES, limits)
