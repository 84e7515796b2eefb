"""The patch of a picture that gaze estimators look at: the face as a camera sees it that looks at its middle.

The published crop (data normalisation, Zhang et al. 2018): 224 pixels, focal length 960, the middle of the face 600 mm
away. A camera that is turned and zoomed in place sees a picture's own pixels, so that a homography makes the patch.
"""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np

from gazenerf.geometry import Camera, Gaze
from gazenerf.head_model import load_head_model
from gazenerf.head_model.model import METRES_PER_UNIT
from gazenerf.subjects import Codes

SIDE, FOCAL, DISTANCE = 224, 960.0, 0.6
"""Pixels, pixels, metres."""

EYE_CORNERS, NOSE = ("36", "39", "42", "45"), ("31", "35")


@lru_cache(maxsize=1)
def face_centre() -> tuple[float, float, float]:
    """The middle between the eyes and the base of the nose of the mean head, world units."""
    model = load_head_model()
    marks = model.mesh(Codes(*(np.zeros(size) for size in model.code_sizes)), Gaze()).landmarks
    eyes, nose = (np.mean([marks[name] for name in names], axis=0) for names in (EYE_CORNERS, NOSE))
    x, y, z = (float(value) for value in 0.5 * (eyes + nose))
    return x, y, z


def patch_camera(camera: Camera, level: bool = True) -> Camera:
    """The camera of the patch, at the same place.

    Args:
        camera: Of the picture, in the head's frame.
        level: Hold the patch level by the head's vertical axis; else by its horizontal one, as the published crop does,
            which turns patches of heads that are seen from the side and from above or below.
    """
    centre = np.asarray(face_centre())
    forward = centre - camera.position
    distance = float(np.linalg.norm(forward)) * METRES_PER_UNIT
    up = (0.0, 1.0, 0.0)
    if not level:
        x, y, z = (float(value) for value in np.cross([1.0, 0.0, 0.0], forward))
        up = (x, y, z)
    fov = 2.0 * np.arctan(0.5 * SIDE / (FOCAL * distance / DISTANCE))
    return Camera.look_at(camera.position, centre, size=SIDE, fov=float(fov), up=up)


def face_patch(picture: np.ndarray, camera: Camera, level: bool = True) -> np.ndarray:
    """(224, 224, 3), of the picture's type; black beyond the picture.

    Args:
        picture: (H, W, 3) uint8, or float32.
        camera: Of the picture.
        level: See `patch_camera`.
    """
    return seen_by(picture, camera, patch_camera(camera, level))


def seen_by(picture: np.ndarray, camera: Camera, turned: Camera) -> np.ndarray:
    """(H', W', 3) what another camera at the same place sees of a picture (H, W, 3); black beyond it.

    Args:
        picture: uint8, or float32.
        camera: That took it.
        turned: The other one, whose pixels should not be much larger than the picture's.
    """
    turn = turned.world_from_camera[:3, :3].T @ camera.world_from_camera[:3, :3]
    half = np.array([[1.0, 0.0, 0.5], [0.0, 1.0, 0.5], [0.0, 0.0, 1.0]])
    move = np.linalg.inv(half) @ turned.intrinsics @ turn @ np.linalg.inv(camera.intrinsics) @ half
    return cv2.warpPerspective(picture, move, (turned.width, turned.height), flags=cv2.INTER_LINEAR)
