"""The gaze of a photograph as the bundled network reads it, by the look of eyes and face.

Geometry knows the gaze by the irises' places on the fitted eyeballs, whose centres nobody sees: a millimetre is five
degrees. What the network goes by is something else, and so is what it misses.
"""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
import torch

from gazenerf.data.rasterizer import Rasterizer
from gazenerf.geometry import Camera
from gazenerf.geometry.cameras import NEUTRAL_DISTANCE, NEUTRAL_FOV
from gazenerf.head_model.interface import HeadMesh
from gazenerf.photographs.picture_terms import SeenGaze
from gazenerf.training.face_patch import seen_by
from gazenerf.training.gaze_estimator import GazeEstimator, load_gaze_estimator

DEVIATIONS = (1.8, 1.4)
"""Degrees of pitch and yaw. On 80 rendered people with hair, from less than 50 degrees aside, it misses by 2.8 and 2.1
(root mean squares), or by 2.2 and 1.4 (deviations told by medians). A little less is taken, because landmarks and
pixels err alike, and so count for too much beside it."""

ASIDE = 50.0
"""Degrees between face and camera at which it misses twice as much; that grows with the square."""

LARGEST = 2048
"""Pixels of the side of the picture that is averaged down to the network's."""


def seen_gaze(image: np.ndarray, camera: Camera, mesh: HeadMesh) -> SeenGaze:
    """What the bundled estimator reads off a photograph.

    Args:
        image: (H, W, 3) uint8 sRGB.
        camera: Of the fitted head.
        mesh: The fitted head; what is beside it is made black, as it is in the pictures that the network learned from.
    """
    with torch.inference_mode():
        estimator = _estimator()
        pitch, yaw = estimator(as_learned(image, camera, mesh, estimator.layout.side))[0].tolist()
    position = camera.position
    aside = np.rad2deg(np.arccos(np.clip(position[2] / np.linalg.norm(position), -1.0, 1.0)))
    more = 1.0 + (aside / ASIDE) ** 2
    return SeenGaze(pitch, yaw, (float(np.deg2rad(DEVIATIONS[0]) * more), float(np.deg2rad(DEVIATIONS[1]) * more)))


def as_learned(image: np.ndarray, camera: Camera, mesh: HeadMesh, side: int) -> torch.Tensor:
    """(1, 3, side, side) the photograph as a neutral camera would have it, see `seen_gaze`."""
    distance = float(np.linalg.norm(camera.position))
    fov = 2.0 * np.arctan(np.tan(0.5 * NEUTRAL_FOV) * NEUTRAL_DISTANCE / distance)

    def neutral(size: int) -> Camera:
        return Camera.look_at(camera.position, np.zeros(3), size=size, fov=float(fov), up=(0.0, 1.0, 0.0))

    finer = 2 ** int(np.clip(np.ceil(np.log2(camera.fx / neutral(side).fx)), 0, np.log2(LARGEST / side)))
    view = neutral(finer * side)
    with Rasterizer((view.width, view.height), 1) as rasterizer:
        parts = rasterizer.render(mesh, np.zeros((len(mesh.vertices), 3)), view).parts
    alone = np.where((parts > 0)[..., None], seen_by(image, camera, view), 0)
    small = cv2.resize(alone.astype(np.float32), (side, side), interpolation=cv2.INTER_AREA)
    return torch.from_numpy(small / 255.0).permute(2, 0, 1)[None]


@lru_cache(maxsize=1)
def _estimator() -> GazeEstimator:
    return load_gaze_estimator()
