"""Epipolar-plane images: one picture row of a short orbit, frame under frame.

On a head that is one 3D thing every trace is a smooth curve. Texture that sticks to the screen draws
vertical lines, texture that flickers broken ones.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Protocol, TypeVar

import numpy as np

from gazenerf.geometry import Camera
from gazenerf.heads.interface import BoundField
from gazenerf.viz.metrics.stream_views import CELLS, check_picture

S = TypeVar("S")
T = TypeVar("T")

FRAMES, SWEEP_DEGREES = 24, 20.0
MARGIN = 24
"""Pixels rendered above and below the rows, more than an up-sampler's neighbourhood."""


class Map(Protocol):
    """The built-in `map`, or an executor's."""

    def __call__(self, do: Callable[[S], T], items: Iterable[S], /) -> Iterable[T]:
        """What a function makes of each item, in their order."""
        ...


def strip_cameras(size: int, frames: int = FRAMES, degrees: float = SWEEP_DEGREES) -> list[Camera]:
    """Cameras from `-degrees` to `degrees` of yaw."""
    return [Camera.orbit(float(np.deg2rad(yaw)), 0.0, size=size) for yaw in np.linspace(-degrees, degrees, frames)]


def epipolar_strips(
    bound: BoundField, points: dict[str, np.ndarray], size: int, *, frames: int = FRAMES, run: Map = map
) -> dict[str, np.ndarray]:
    """Name to (frames, W, 3) epipolar-plane image, the first frame (yaw -20) on top.

    A row stays where its point is seen from the front. Only a band of each picture that holds all
    rows is rendered.

    Args:
        points: Name to a world point (3,) whose row is shown.
        size: Width of the pictures.
        run: How frames are rendered.
    """
    cameras = strip_cameras(size, frames)
    front = Camera.orbit(0.0, 0.0, size=size)
    rows = {
        name: int(np.clip(front.project(np.asarray(point, dtype=np.float64))[0][1], 0, size - 1))
        for name, point in points.items()
    }
    low = max(0, (min(rows.values()) - MARGIN) // CELLS * CELLS)
    high = min(size, -(-(max(rows.values()) + MARGIN) // CELLS) * CELLS)

    def band(camera: Camera) -> np.ndarray:
        part = camera.windowed((slice(low, high), slice(0, size)))
        image = bound.render(part).image
        check_picture(image, part, "the field's picture")
        return image

    bands = list(run(band, cameras))
    return {name: np.stack([image[row - low] for image in bands]) for name, row in rows.items()}
