"""The face of one person followed through a video, by detections in single frames."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gazenerf.photographs.detector import detect
from gazenerf.photographs.landmarks import DENSE, FaceLandmarks, choose_face

BATCH_BYTES, MOST_BATCH = 256 * 2**20, 128
"""Frames are detected in batches of at most so many bytes and frames: each starts MediaPipe once."""

REACH, REACH_PER_FRAME = 1.0, 0.2
"""Distances between the eyes by which a face may have moved since it was last seen, and more for each frame since."""


def batch_size(height: int, width: int) -> int:
    """How many frames are detected at once."""
    return int(np.clip(BATCH_BYTES // (3 * height * width), 1, MOST_BATCH))


class FaceTrack:
    """Follows the face that was chosen where it was first seen.

    Args:
        face: Its number in the first frame that has faces, from 1, the largest first; None where that has one.
        name: Of the video, for messages.
    """

    def __init__(self, face: int | None, name: str) -> None:
        self._face, self._name = face, name
        self._last: FaceLandmarks | None = None
        self._since = 0

    def goes_on_from(self, points: np.ndarray) -> None:
        """Take up after frames that are done; points (T, 478, 2), NaN where the face was not seen."""
        for marks in points:
            self._seen(FaceLandmarks(marks) if np.isfinite(marks).all() else None)

    def follow(self, faces: Sequence[FaceLandmarks]) -> FaceLandmarks | None:
        """The face among those of the next frame; None where it is not there.

        Raises:
            UserError: the first frame with faces has several and no number was given.
        """
        found: FaceLandmarks | None = None
        if faces and self._last is None:
            found = choose_face(faces, self._face, f"the first frame with faces of {self._name}")
        elif faces and self._last is not None:
            last = self._last.points.mean(axis=0)
            away = [float(np.linalg.norm(face.points.mean(axis=0) - last)) for face in faces]
            near = int(np.argmin(away))
            if away[near] <= (REACH + REACH_PER_FRAME * self._since) * self._last.interocular:
                found = faces[near]
        self._seen(found)
        return found

    def _seen(self, face: FaceLandmarks | None) -> None:
        self._last, self._since = (self._last, self._since + 1) if face is None else (face, 0)


def followed(frames: Sequence[np.ndarray], track: FaceTrack, python: Path | None) -> np.ndarray:
    """(T, 478, 2) float32 landmarks of the followed face in frames (H, W, 3), pixels; NaN where it is not seen.

    Raises:
        UserError: MediaPipe is absent or fails, or it is not said which of several faces is meant.
    """
    points = np.full((len(frames), DENSE, 2), np.nan, np.float32)
    for number, detection in enumerate(detect(frames, python)):
        face = track.follow(detection.faces)
        if face is not None:
            points[number] = face.points
    return points
