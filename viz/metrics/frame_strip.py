"""An epipolar-plane image from frames: one row of each frame of an orbit, in the order of azimuth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gazenerf.viz.metrics.colmap import middle_of_attention
from gazenerf.viz.metrics.frame_warps import PosedPicture

RING_FRAMES, RING_DEGREES, RING_STEP_DEGREES = 8, 1.5, 15.0
"""An orbit has at least so many frames whose heights differ by less than so much, no step larger than that."""


@dataclass(frozen=True)
class Strip:
    """An epipolar-plane image.

    Attributes:
        image: (frames, W, 3) uint8, one row of each frame of the orbit, in the order of azimuth.
        row: Which row of the pictures.
        frames: Indices.
        degrees: Azimuth that the orbit covers.
    """

    image: np.ndarray
    row: int
    frames: tuple[int, ...]
    degrees: float


def epipolar_strip(frames: Sequence[PosedPicture]) -> Strip | None:
    """The row through the middle of attention over the largest orbit among the frames, None where there is none."""
    cameras = [frame.camera for frame in frames]
    middle = middle_of_attention(cameras)
    up = -np.mean([camera.world_from_camera[:3, 1] for camera in cameras], axis=0)
    if np.linalg.norm(up) < 0.1:
        return None
    up /= np.linalg.norm(up)
    offsets = np.array([camera.position for camera in cameras]) - middle
    distances = np.linalg.norm(offsets, axis=1)
    if distances.min() <= 0:
        return None
    heights = np.degrees(np.arcsin(np.clip(offsets @ up / distances, -1.0, 1.0)))
    side = np.cross(up, offsets[0] - (offsets[0] @ up) * up)
    if np.linalg.norm(side) < 1e-9:
        return None
    side /= np.linalg.norm(side)
    azimuth = np.degrees(np.arctan2(offsets @ side, offsets @ np.cross(side, up)))
    best: np.ndarray = np.zeros(0, int)
    for height, distance in zip(heights, distances, strict=True):
        ring = np.flatnonzero((abs(heights - height) < RING_DEGREES) & (abs(distances / distance - 1.0) < 0.02))
        ring = _longest_run(ring[np.argsort(azimuth[ring], kind="stable")], azimuth)
        if len(ring) > len(best):
            best = ring
    if len(best) < RING_FRAMES:
        return None
    pixel, _ = cameras[best[0]].project(middle)
    row = int(np.clip(pixel[1], 0, cameras[0].height - 1))
    image = np.stack([frames[i].image[row] for i in best])
    covered = float(np.mod(azimuth[best[-1]] - azimuth[best[0]], 360.0))
    return Strip(image, row, tuple(int(i) for i in best), covered)


def _longest_run(ring: np.ndarray, azimuth: np.ndarray) -> np.ndarray:
    """Of frames in the order of azimuth (degrees) the longest run around the circle without a large step."""
    if len(ring) < 2:
        return ring
    steps = np.mod(np.roll(azimuth[ring], -1) - azimuth[ring], 360.0)
    breaks = np.flatnonzero((steps > RING_STEP_DEGREES) | (steps < 1e-3))
    if not len(breaks):
        return ring
    around = np.roll(ring, -(breaks[-1] + 1))
    ends = np.mod(breaks - breaks[-1] - 1, len(ring))
    return max(np.split(around, np.sort(ends) + 1), key=len)
