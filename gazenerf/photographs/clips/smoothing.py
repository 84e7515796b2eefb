"""Fits of single frames made smooth over time, without delay.

Head rotation and place, and the expression but for the lids, go through a Savitzky-Golay filter of order 2 (a parabola
fitted to the frames about each one). Gazes go through a running median, which drops what jumps out for a frame or two
but keeps the quick turns between two places that the eyes rest on. Lids stay as they are, since blinks are quick too.
Frames that follow each other without a gap are smoothed together.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from scipy.ndimage import median_filter
from scipy.signal import savgol_filter
from scipy.spatial.transform import Rotation

from gazenerf.photographs.clips.frame_fits import FrameFits

POSE_SECONDS, GAZE_FRAMES, ORDER = 0.36, 5, 2
"""Length of the filter's window, of the median's, and the degree of the parabola."""

LEAST_WINDOW = 5
LIDS = "eye"
"""Expressions whose names begin with this stay as they are."""


def smoothed(fits: FrameFits, rate: float, expression_names: Sequence[str]) -> FrameFits:
    """The same frames, smooth over time.

    Args:
        fits: Of all frames of a clip.
        rate: Frames per second.
        expression_names: Of the expression coefficients.
    """
    poses, gazes, expressions = fits.poses.copy(), fits.gazes.copy(), fits.expressions.copy()
    free = np.array([not name.startswith(LIDS) for name in expression_names])
    window = max(LEAST_WINDOW, round(POSE_SECONDS * rate) // 2 * 2 + 1)
    for run in runs(fits.fitted):
        gazes[run] = median_filter(gazes[run], size=(GAZE_FRAMES, 1), mode="nearest")
        size = min(window, (run.stop - run.start - 1) // 2 * 2 + 1)
        if size < LEAST_WINDOW:
            continue
        middle = Rotation.from_matrix(poses[run.start, :3, :3])
        turns = (Rotation.from_matrix(poses[run, :3, :3]) * middle.inv()).as_rotvec()
        turned = Rotation.from_rotvec(savgol_filter(turns, size, ORDER, axis=0)) * middle
        poses[run, :3, :3] = turned.as_matrix()
        poses[run, :3, 3] = savgol_filter(poses[run, :3, 3], size, ORDER, axis=0)
        smooth = np.asarray(savgol_filter(expressions[run][:, free], size, ORDER, axis=0))
        expressions[run, free] = np.clip(smooth, 0.0, 1.0)
    return replace(fits, poses=poses, gazes=gazes, expressions=expressions)


def runs(fitted: np.ndarray) -> Iterator[slice]:
    """Stretches of frames (T,) bool that follow each other."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], fitted.astype(np.int8), [0]])))
    for first, last in edges.reshape(-1, 2):
        yield slice(int(first), int(last))
