"""What a capture asks of a feature map: which rays to cast, and what they should meet."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from gazenerf.data.captures import Capture

EYE_CROP = (12, 32)
"""Height and width, in feature pixels of a map of 64, of the crop in which the eyes stream is rendered."""


MOUTH = (0.0, -0.56, 0.92)
"""Where mouths are in the head frame, world units, to a centimetre or so; eyes are at height 0."""


def eye_crop(feature_size: int) -> tuple[int, int]:
    """Height and width of that crop in a feature map of F x F: its share of 64 where F is larger, F at most."""
    scale = max(feature_size / 64.0, 1.0)
    return min(round(scale * EYE_CROP[0]), feature_size), min(round(scale * EYE_CROP[1]), feature_size)


@dataclass
class RayTargets:
    """What a feature map should show of one capture of size S x S.

    Attributes:
        rays: (R,) int32 flat feature indices whose block or a neighbour shows the head.
        distance: (R,) float32 Euclidean distance to the surface seen through the block, world units
            (that of the nearest block with a surface where this one has none).
        has_surface: (R,) bool the block itself shows a surface.
        face_coverage: (R,) float32 share of the block's pixels that show the face without eyes.
        eyes_coverage: (R,) float32 share that shows an eye.
        eye_rays: (E,) int32 positions in `rays` of the blocks near an eye.
        eye_corner: Row and column of the eye crop in the feature map.
        mouth: Flat feature index of where the mouth is, see `MOUTH`; -1 where it is not in the picture or looks away.
    """

    rays: np.ndarray
    distance: np.ndarray
    has_surface: np.ndarray
    face_coverage: np.ndarray
    eyes_coverage: np.ndarray
    eye_rays: np.ndarray
    eye_corner: tuple[int, int]
    mouth: int = -1


def corner_around(places: np.ndarray, shape: tuple[int, int], feature_size: int) -> tuple[int, int]:
    """Row and column at which a window begins that lies around some feature pixels, within the map.

    Args:
        places: (N,) flat feature indices, at least one.
        shape: Height and width of the window, feature pixels.
        feature_size: Side of the feature map.
    """
    middles = [(index.min() + index.max() + 1) // 2 for index in np.divmod(places, feature_size)]
    row, column = (
        int(np.clip(middle - side // 2, 0, feature_size - side)) for middle, side in zip(middles, shape, strict=True)
    )
    return row, column


def ray_targets(capture: Capture, feature_size: int, all_rays: bool = False, eye_dilation: int = 2) -> RayTargets:
    """Summarise a capture at feature-map resolution.

    With `all_rays` both streams are cast through the whole feature map, as published.

    Raises:
        ValueError: the picture's side is not a multiple of the feature map's.
    """
    height, width = capture.parts.shape
    if height != width or height % feature_size:
        raise ValueError(f"a {width}x{height} picture cannot feed a {feature_size}x{feature_size} feature map")
    k = height // feature_size
    blocks = capture.parts.reshape(feature_size, k, feature_size, k).transpose(0, 2, 1, 3).reshape(-1, k * k)
    depth = capture.depth.reshape(feature_size, k, feature_size, k).transpose(0, 2, 1, 3).reshape(-1, k * k)
    face = (blocks == 1).mean(axis=1).astype(np.float32)
    eyes = (blocks >= 2).mean(axis=1).astype(np.float32)
    seen = (depth > 0) & (blocks > 0)
    has_surface = seen.any(axis=1)
    middle = np.sort(np.where(seen, depth, np.inf), axis=1)
    distance = middle[np.arange(len(middle)), np.maximum(seen.sum(axis=1) - 1, 0) // 2]
    grid = has_surface.reshape(feature_size, feature_size)
    nearest = ndimage.distance_transform_edt(~grid, return_distances=False, return_indices=True)
    assert isinstance(nearest, np.ndarray)
    distance = distance.reshape(grid.shape)[nearest[0], nearest[1]].reshape(-1)
    cast = np.ones_like(grid) if all_rays else ndimage.binary_dilation(grid, iterations=1)
    dilated = ndimage.binary_dilation(eyes.reshape(grid.shape) > 0, np.ones((3, 3)), iterations=eye_dilation)
    near_eye = (np.asarray(dilated, dtype=bool) & np.asarray(cast, dtype=bool)) | all_rays
    rays = np.flatnonzero(cast)
    position = np.full(cast.size, -1)
    position[rays] = np.arange(rays.size)
    eye_rays = position[np.flatnonzero(near_eye)]
    shown = np.flatnonzero(eyes > 0)
    middle_pixel = np.array([feature_size // 2 * (feature_size + 1)])
    corner = corner_around(shown if shown.size else middle_pixel, eye_crop(feature_size), feature_size)
    return RayTargets(
        rays.astype(np.int32),
        distance[rays].astype(np.float32),
        np.asarray(has_surface)[rays],
        face[rays],
        eyes[rays],
        eye_rays.astype(np.int32),
        corner,
        _mouth(capture, feature_size),
    )


def _mouth(capture: Capture, feature_size: int) -> int:
    if capture.camera.position[2] <= 0.0:
        return -1
    pixel, _ = capture.camera.resized(feature_size).project(np.array(MOUTH))
    column, row = np.floor(pixel).astype(int)
    inside = 0 <= row < feature_size and 0 <= column < feature_size
    return int(row * feature_size + column) if inside else -1


PER_RAY = ("rays", "distance", "has_surface", "face_coverage", "eyes_coverage")
"""Values of `RayTargets` that each ray has."""


def only_rays(target: RayTargets, keep: np.ndarray) -> RayTargets:
    """The targets without some of their rays; keep (R,) bool says which stay."""
    place = np.cumsum(keep) - 1
    eyes = target.eye_rays[keep[target.eye_rays]]
    kept = {name: getattr(target, name)[keep] for name in PER_RAY}
    return replace(target, **kept, eye_rays=place[eyes].astype(np.int32))
