"""Captures as training batches: which rays to cast, how far the surface is, what they should show."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from scipy import ndimage

from gazenerf.cores import usable_cores
from gazenerf.data.captures import Capture

EYE_CROP = (12, 32)
"""Height and width, in feature pixels of a map of 64, of the crop in which the eyes stream is rendered."""


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
    """

    rays: np.ndarray
    distance: np.ndarray
    has_surface: np.ndarray
    face_coverage: np.ndarray
    eyes_coverage: np.ndarray
    eye_rays: np.ndarray
    eye_corner: tuple[int, int]


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
    crop = eye_crop(feature_size)
    if (eyes > 0).any():
        rows, columns = np.divmod(np.flatnonzero(eyes > 0), feature_size)
        centre = (rows.min() + rows.max() + 1) // 2, (columns.min() + columns.max() + 1) // 2
    else:
        centre = feature_size // 2, feature_size // 2
    corner = tuple(int(np.clip(c - s // 2, 0, feature_size - s)) for c, s in zip(centre, crop, strict=True))
    return RayTargets(
        rays.astype(np.int32),
        distance[rays].astype(np.float32),
        np.asarray(has_surface)[rays],
        face[rays],
        eyes[rays],
        eye_rays.astype(np.int32),
        (corner[0], corner[1]),
    )


FREE_RAYS = 1024
"""Random rays of each capture for the empty space."""


@dataclass
class Batch:
    """B captures, rays padded to one length. All tensors; shapes with R rays, E eye rays.

    Attributes:
        index: (B,) int64 which captures.
        image: (B, 3, H, W) float32 sRGB.
        parts: (B, H, W) uint8, values of `Capture.parts`.
        shape_code, appearance_code, gaze: (B, .) float32; gaze is the native label.
        rays_o, rays_d: (B, R, 3) float32 unit rays, world.
        rays: (B, R) int64 flat feature indices.
        valid: (B, R) bool; padding is False.
        distance, face_coverage, eyes_coverage: (B, R) float32; has_surface (B, R) bool.
        eye_rays: (B, E) int64 positions in R; eye_valid (B, E) bool.
        eye_corner: (B, 2) int64.
        free_d: (B, F, 3) float32 unit directions through random feature pixels, from rays_o[:, 0].
        free_limit: (B, F) float32 distance up to which that ray is known to be empty.
        eye_centres: (B, 2, 3) float32 world; eye_radius float. None when unknown.
    """

    index: torch.Tensor
    image: torch.Tensor
    parts: torch.Tensor
    shape_code: torch.Tensor
    appearance_code: torch.Tensor
    gaze: torch.Tensor
    rays_o: torch.Tensor
    rays_d: torch.Tensor
    rays: torch.Tensor
    valid: torch.Tensor
    distance: torch.Tensor
    has_surface: torch.Tensor
    face_coverage: torch.Tensor
    eyes_coverage: torch.Tensor
    eye_rays: torch.Tensor
    eye_valid: torch.Tensor
    eye_corner: torch.Tensor
    free_d: torch.Tensor
    free_limit: torch.Tensor
    eye_centres: torch.Tensor | None
    eye_radius: float

    def to(self, device: torch.device) -> Batch:
        """The same batch on another device; from pinned memory the copies are not waited for."""
        return self._each(lambda value: value.to(device, non_blocking=value.is_pinned()))

    def pinned(self) -> Batch:
        """The same batch in memory from which a GPU copies by itself."""
        return self._each(torch.Tensor.pin_memory)

    def _each(self, change: Callable[[torch.Tensor], torch.Tensor]) -> Batch:
        moved: dict[str, Any] = {k: change(v) if isinstance(v, torch.Tensor) else v for k, v in vars(self).items()}
        return Batch(**moved)


class BatchMaker:
    """Assembles batches from captures held in memory.

    Args:
        captures: Any sequence of captures of one size.
        feature_size: Side of the feature map.
        ray_offset: Feature-pixel coordinate of ray i is i + this (0.5 native, 0 published).
        all_rays: Cast both streams through the whole feature map.
        eyeballs: Capture to (eye centres (2, 3), radius) in the world; None when unknown.
        progress: Called with the number of captures summarised so far.
    """

    def __init__(
        self,
        captures: Sequence[Capture],
        feature_size: int,
        ray_offset: float = 0.5,
        all_rays: bool = False,
        eyeballs: Callable[[Capture], tuple[np.ndarray, float]] | None = None,
        progress: Callable[[int], None] | None = None,
    ) -> None:
        self.captures = captures
        self.feature_size = feature_size
        self.ray_offset = ray_offset
        self.targets: list[RayTargets] = []
        self.eyeballs: list[tuple[np.ndarray, float] | None] = []
        with ThreadPoolExecutor(usable_cores()) as threads:
            summaries = threads.map(lambda capture: ray_targets(capture, feature_size, all_rays), captures)
            for number, (capture, target) in enumerate(zip(captures, summaries, strict=True)):
                self.targets.append(target)
                self.eyeballs.append(None if eyeballs is None else eyeballs(capture))
                if progress is not None:
                    progress(number + 1)

    def __len__(self) -> int:
        return len(self.captures)

    def batch(self, indices: Sequence[int], rng: np.random.Generator, free_rays: int = FREE_RAYS) -> Batch:
        """The batch of some captures, with `free_rays` random rays each for the empty space."""
        captures = [self.captures[i] for i in indices]
        targets = [self.targets[i] for i in indices]
        n_rays = max(target.rays.size for target in targets)
        n_eyes = max(1, *(target.eye_rays.size for target in targets))
        size = self.feature_size

        def padded(values: list[np.ndarray], length: int) -> torch.Tensor:
            out = np.zeros((len(values), length), dtype=values[0].dtype)
            for row, value in zip(out, values, strict=True):
                row[: value.size] = value
                if value.size:
                    row[value.size :] = value[-1]
            return torch.from_numpy(out)

        def lengths(counts: list[int], length: int) -> torch.Tensor:
            return torch.arange(length)[None] < torch.tensor(counts)[:, None]

        rays = padded([target.rays for target in targets], n_rays).long()
        origins, directions = [], []
        for capture, row in zip(captures, rays.numpy(), strict=True):
            camera = capture.camera.resized(size)
            pixels = np.stack([row % size, row // size], axis=-1) + self.ray_offset
            rays_o, rays_d = camera.rays(pixels)
            origins.append(rays_o)
            directions.append(rays_d)
        free_d, free_limit = [], []
        for capture, target in zip(captures, targets, strict=True):
            limit = np.full(size * size, np.inf, dtype=np.float32)
            limit[target.rays] = target.distance
            chosen = rng.integers(0, size * size, free_rays)
            pixels = np.stack([chosen % size, chosen // size], axis=-1) + self.ray_offset
            free_d.append(capture.camera.resized(size).rays(pixels)[1])
            free_limit.append(limit[chosen])
        known = [self.eyeballs[i] for i in indices]
        centres = None
        radius = 0.0
        if all(eye is not None for eye in known):
            centres = torch.from_numpy(np.stack([eye[0] for eye in known if eye is not None]).astype(np.float32))
            radius = float(np.mean([eye[1] for eye in known if eye is not None]))
        return Batch(
            index=torch.tensor(list(indices)),
            image=torch.from_numpy(np.stack([c.image for c in captures])).permute(0, 3, 1, 2).float() / 255.0,
            parts=torch.from_numpy(np.stack([c.parts for c in captures])),
            shape_code=torch.from_numpy(np.stack([c.codes.shape_code for c in captures])),
            appearance_code=torch.from_numpy(np.stack([c.codes.appearance_code for c in captures])),
            gaze=torch.from_numpy(np.stack([c.gaze.label for c in captures])),
            rays_o=torch.from_numpy(np.stack(origins).astype(np.float32)),
            rays_d=torch.from_numpy(np.stack(directions).astype(np.float32)),
            rays=rays,
            valid=lengths([t.rays.size for t in targets], n_rays),
            distance=padded([t.distance for t in targets], n_rays),
            has_surface=padded([t.has_surface for t in targets], n_rays),
            face_coverage=padded([t.face_coverage for t in targets], n_rays),
            eyes_coverage=padded([t.eyes_coverage for t in targets], n_rays),
            eye_rays=padded([t.eye_rays for t in targets], n_eyes).long(),
            eye_valid=lengths([t.eye_rays.size for t in targets], n_eyes),
            eye_corner=torch.tensor([t.eye_corner for t in targets]),
            free_d=torch.from_numpy(np.stack(free_d).astype(np.float32)),
            free_limit=torch.from_numpy(np.stack(free_limit)),
            eye_centres=centres,
            eye_radius=radius,
        )
