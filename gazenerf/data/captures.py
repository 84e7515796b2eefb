"""One capture: a picture of a head with everything known about it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gazenerf.geometry import Camera, Gaze
from gazenerf.subjects import Codes


@dataclass(frozen=True)
class Capture:
    """A picture with its masks, depth, camera, gaze and codes.

    Attributes:
        image: (H, W, 3) uint8 sRGB on the capture background (black).
        parts: (H, W) uint8 of the pixel's centre: 0 background, 1 face without eyes, 2 left eye,
            3 right eye (the subject's).
        depth: (H, W) float32 Euclidean distance along the pixel-centre ray, world units, 0 where
            there is no surface.
        camera: Its size is the picture's.
        gaze: In the head frame.
        codes: The head-model parameters the picture was made from.
        person: Index of the person.
        view: Index of the view among the person's.
    """

    image: np.ndarray
    parts: np.ndarray
    depth: np.ndarray
    camera: Camera
    gaze: Gaze
    codes: Codes
    person: int
    view: int

    @property
    def head_mask(self) -> np.ndarray:
        """(H, W) bool."""
        return self.parts > 0

    @property
    def face_mask(self) -> np.ndarray:
        """(H, W) bool, the head without its eyes."""
        return self.parts == 1

    @property
    def eyes_mask(self) -> np.ndarray:
        """(H, W) bool, both eyes."""
        return self.parts >= 2
