"""The gaze of a photograph as the bundled network reads it, by the look of eyes and face.

Geometry knows the gaze by the irises' places on the fitted eyeballs, whose centres nobody sees: a millimetre is five
degrees. What the network goes by is something else, and so is what it misses.
"""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
import torch
import torch.nn.functional as F

from gazenerf.data.rasterizer import Rasterizer
from gazenerf.geometry import Camera
from gazenerf.geometry.cameras import NEUTRAL_DISTANCE, NEUTRAL_FOV
from gazenerf.head_model.interface import HeadMesh
from gazenerf.photographs.picture_terms import SeenGaze
from gazenerf.training.face_patch import seen_by
from gazenerf.training.gaze_estimator import GazeEstimator, load_gaze_estimator

DEVIATIONS = (1.4, 1.1)
"""Degrees of pitch and yaw that are taken where readings agree with each other. By medians it is 2.2 and 1.4 for 80
rendered people from less than 50 degrees aside, but landmarks and pixels err alike and count for too much beside it."""

UNSURE = 2.0
"""Deviations of the readings of one photograph, slightly changed, that the mean of them is off besides: on 24 rendered
people they have 0.6 degrees of pitch (median) and go with what is missed, on the photograph in docs/photos.md 1.5."""

SCALES, SHIFTS, TURNS, GAMMAS = (0.97, 1.03), (-0.02, 0.02), (-2.0, 2.0), (0.85, 1.18)
"""By which the photograph is changed, one at a time: size, places in halves of a side, degrees, exponents of sRGB."""

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
        read = estimator(slightly_changed(as_learned(image, camera, mesh, estimator.layout.side))).double()
    pitch, yaw = read.mean(dim=0).tolist()
    least = torch.deg2rad(torch.tensor(DEVIATIONS, dtype=torch.float64))
    position = camera.position
    aside = np.rad2deg(np.arccos(np.clip(position[2] / np.linalg.norm(position), -1.0, 1.0)))
    off = (least.square() + (UNSURE * read.std(dim=0)).square()).sqrt() * (1.0 + (aside / ASIDE) ** 2)
    return SeenGaze(pitch, yaw, (float(off[0]), float(off[1])))


def slightly_changed(picture: torch.Tensor) -> torch.Tensor:
    """(N, 3, S, S) a picture (1, 3, S, S) and others whose gaze is all but the same."""
    moves = [(1.0, 0.0, 0.0, 0.0)]
    moves += [(scale, 0.0, 0.0, 0.0) for scale in SCALES] + [(1.0, shift, 0.0, 0.0) for shift in SHIFTS]
    moves += [(1.0, 0.0, shift, 0.0) for shift in SHIFTS] + [(1.0, 0.0, 0.0, np.deg2rad(turn)) for turn in TURNS]
    maps = [
        [[scale * np.cos(turn), -scale * np.sin(turn), x], [scale * np.sin(turn), scale * np.cos(turn), y]]
        for scale, x, y, turn in moves
    ]
    grid = F.affine_grid(torch.tensor(maps, dtype=torch.float32), [len(maps), *picture.shape[1:]], align_corners=False)
    moved = F.grid_sample(picture.expand(len(maps), -1, -1, -1), grid, align_corners=False)
    return torch.cat([moved, *(picture**gamma for gamma in GAMMAS)])


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
