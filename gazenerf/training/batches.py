"""Captures as training batches: which rays to cast, how far the surface is, what they should show."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from gazenerf.cores import usable_cores
from gazenerf.data.captures import Capture
from gazenerf.head_model.follow import codes_at
from gazenerf.training.ray_targets import RayTargets, ray_targets
from gazenerf.training.windows import Window

FREE_RAYS = 1024
"""Random rays of each capture for the empty space."""


@dataclass
class Batch:
    """B captures, or a window of each, rays padded to one length. All tensors; shapes with R rays, E eye rays.

    Attributes:
        index: (B,) int64 which captures.
        image: (B, 3, H, W) float32 sRGB; of the window where there is one.
        parts: (B, H, W) uint8, values of `Capture.parts`.
        shape_code, appearance_code, gaze: (B, .) float32, lids at the gaze (`codes_at`); gaze is the native label.
        rays_o, rays_d: (B, R, 3) float32 unit rays, world.
        rays: (B, R) int64 flat feature indices.
        valid: (B, R) bool; padding is False.
        distance, face_coverage, eyes_coverage: (B, R) float32; has_surface (B, R) bool.
        eye_rays: (B, E) int64 positions in R; eye_valid (B, E) bool.
        eye_corner: (B, 2) int64; of the window where there is one.
        free_d: (B, F, 3) float32 unit directions through random feature pixels, from rays_o[:, 0].
        free_limit: (B, F) float32 distance up to which that ray is known to be empty.
        eye_centres: (B, 2, 3) float32 world; eye_radius float. None when unknown.
        window: Height and width of the windows, feature pixels; None where whole pictures are rendered.
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
    window: tuple[int, int] | None = None

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
        window: Batches are of such windows, drawn anew each time.
        progress: Called with the number of captures summarised so far.
    """

    def __init__(
        self,
        captures: Sequence[Capture],
        feature_size: int,
        ray_offset: float = 0.5,
        all_rays: bool = False,
        eyeballs: Callable[[Capture], tuple[np.ndarray, float]] | None = None,
        window: Window | None = None,
        progress: Callable[[int], None] | None = None,
    ) -> None:
        self.captures = captures
        self.window = window
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
        corners: list[tuple[int, int]] | None = None
        if self.window is not None:
            window, side = self.window, self.feature_size
            corners = [window.corner(target, side, rng) for target in targets]
            targets = [window.within(t, corner, side) for t, corner in zip(targets, corners, strict=True)]
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
            image=self._shown([c.image for c in captures], corners).permute(0, 3, 1, 2).float() / 255.0,
            parts=self._shown([c.parts for c in captures], corners),
            shape_code=torch.from_numpy(np.stack([codes_at(c.codes, c.gaze).shape_code for c in captures])),
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
            window=None if self.window is None else (self.window.height, self.window.width),
        )

    def _shown(self, pictures: list[np.ndarray], corners: list[tuple[int, int]] | None) -> torch.Tensor:
        """Pictures (H, W, ...) one on the other, cut to the windows at corners where there are some."""
        if corners is not None and self.window is not None:
            k = pictures[0].shape[0] // self.feature_size
            height, width = k * self.window.height, k * self.window.width
            pictures = [picture[k * row :, k * column :][:height, :width]
                        for picture, (row, column) in zip(pictures, corners, strict=True)]  # fmt: skip
        return torch.from_numpy(np.stack(pictures))
