"""Cameras that a visitor keeps, and the keyframe file of `gazenerf orbit --camera-path` that they make."""

from __future__ import annotations

import json
import threading
from typing import Any

import numpy as np

from gazenerf.geometry import Camera
from gazenerf.geometry.keyframes import Keyframe, keyframe_path, keyframes_of
from gazenerf.viz.viewer.viewpoint import Viewpoint

LEVEL = 1e-3
"""A camera whose horizon is tilted by less (radians) is written as level, so that paths through it move on arcs."""


def keyframe(viewpoint: Viewpoint, target: np.ndarray) -> dict[str, Any]:
    """One key of a keyframe file.

    The field of view of the square pictures that `gazenerf orbit` makes is the viewpoint's vertical one: they show the
    middle of the page.

    Args:
        viewpoint: Where the visitor looks from.
        target: (3,) what the visitor's camera turns about, world units.
    """
    pose, fov = viewpoint.world_from_camera, float(np.rad2deg(viewpoint.fov))
    try:
        level = Camera.look_at(pose[:3, 3], (float(target[0]), float(target[1]), float(target[2])), size=1)
    except ValueError:  # straight from above, or from within the target
        level = None
    if level is not None and np.abs(level.world_from_camera - pose).max() < LEVEL:
        place = {"position": _rounded(pose[:3, 3]), "target": _rounded(target)}
    else:
        place = {"world_from_camera": pose.tolist()}
    return place | {"fov": round(fov, 6)}


def _rounded(point: np.ndarray) -> list[float]:
    return [round(float(value), 6) for value in point]


class Keyframes:
    """The kept cameras, in order; safe to use from several threads."""

    def __init__(self) -> None:
        self._keys: list[dict[str, Any]] = []
        self._lock = threading.Lock()

    def __len__(self) -> int:
        return len(self._keys)

    def add(self, key: dict[str, Any]) -> None:
        """Keep one more."""
        with self._lock:
            self._keys.append(key)

    def drop_last(self) -> None:
        """Forget the last one, if there is any."""
        with self._lock:
            del self._keys[-1:]

    def clear(self) -> None:
        """Forget all."""
        with self._lock:
            self._keys.clear()

    def path(self, frames: int) -> tuple[list[Keyframe], list[Camera]]:
        """The keys, and cameras along the path that `gazenerf orbit` takes through them, back to the first one.

        Raises:
            UserError: fewer than two keys, or neighbours that turn by half a turn.
        """
        keys, loop = keyframes_of(json.loads(self.text()), "this path")
        return keys, keyframe_path(keys, frames, loop=loop)

    def text(self, loop: bool = True) -> str:
        """The keyframe file (docs/orbits.md)."""
        with self._lock:
            return json.dumps({"loop": loop, "keyframes": self._keys}, indent=1)
