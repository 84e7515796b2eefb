"""Captures held on a device, and batches gathered there."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from gazenerf.head_model.follow import codes_at
from gazenerf.training.batches import FREE_RAYS, Batch, BatchMaker
from gazenerf.training.ray_targets import PER_RAY, RayTargets


def sent(values: np.ndarray, device: torch.device) -> torch.Tensor:
    """Host numbers on a device, without waiting for what the device is doing."""
    tensor = torch.from_numpy(np.ascontiguousarray(values))
    return tensor.pin_memory().to(device, non_blocking=True) if device.type == "cuda" else tensor.to(device)


class DeviceBatchMaker:
    """The batches of a `BatchMaker`, of captures that lie on a device: pictures and parts as uint8, rays as tables.

    Of a capture's depth they keep what a batch holds, one distance a ray. Only the indices of a batch and its
    random numbers, drawn from the same generator in the same order, go from the host to the device at a step.

    Args:
        maker: The slow reference, whose captures and summaries are copied.
        device: Where they are kept and batches are made.

    Raises:
        torch.OutOfMemoryError: they do not fit; `device_bytes` says how much they take.
    """

    def __init__(self, maker: BatchMaker, device: torch.device) -> None:
        self.device, self.feature_size, self.ray_offset = device, maker.feature_size, maker.ray_offset
        targets, captures = maker.targets, maker.captures
        self._n_rays = np.array([target.rays.size for target in targets])
        self._n_eyes = np.array([target.eye_rays.size for target in targets])
        self._eyeballs = maker.eyeballs
        self._rays = {name: _table([getattr(t, name) for t in targets]).to(device) for name in PER_RAY}
        self._eye_rays = _table([target.eye_rays for target in targets]).to(device)
        self._counts = torch.from_numpy(np.stack([self._n_rays, self._n_eyes], axis=1)).to(device)
        self._image = _pile([capture.image for capture in captures], device)
        self._parts = _pile([capture.parts for capture in captures], device)

        def rows(values: list[np.ndarray]) -> torch.Tensor:
            return torch.from_numpy(np.stack(values)).to(device)

        self._shape_code = rows([codes_at(capture.codes, capture.gaze).shape_code for capture in captures])
        self._appearance_code = rows([capture.codes.appearance_code for capture in captures])
        self._gaze = rows([capture.gaze.label for capture in captures])
        self._eye_corner = rows([np.array(target.eye_corner, dtype=np.int64) for target in targets])
        cameras = [capture.camera.resized(self.feature_size) for capture in captures]
        self._intrinsics = rows([np.array([c.fx, c.fy, c.cx, c.cy], dtype=np.float64) for c in cameras])
        self._rotation = rows([np.asarray(c.world_from_camera[:3, :3], dtype=np.float64) for c in cameras])
        self._position = rows([np.asarray(c.position, dtype=np.float64) for c in cameras])
        known = [np.zeros((2, 3)) if eye is None else eye[0] for eye in maker.eyeballs]
        self._centres = rows([centres.astype(np.float32) for centres in known])

    def __len__(self) -> int:
        return len(self._n_rays)

    def batch(self, indices: Sequence[int], rng: np.random.Generator, free_rays: int = FREE_RAYS) -> Batch:
        """The batch of some captures; see `BatchMaker.batch`, which gives the same for the same generator."""
        chosen, size = np.asarray(indices), self.feature_size
        n_rays, n_eyes = int(self._n_rays[chosen].max()), max(1, int(self._n_eyes[chosen].max()))
        free = np.stack([rng.integers(0, size * size, free_rays) for _ in indices])
        index, free_pixels = sent(chosen, self.device), sent(free, self.device)
        per_ray = {name: table[index, :n_rays] for name, table in self._rays.items()}
        rays, counts = per_ray["rays"].long(), self._counts[index]
        limit = per_ray["distance"].new_full((len(chosen), size * size), float("inf"))
        limit = limit.scatter(1, rays, per_ray["distance"])
        eyes = [eye for eye in (self._eyeballs[i] for i in indices) if eye is not None]
        known = len(eyes) == len(chosen)
        return Batch(
            index=index,
            image=self._image[index].permute(0, 3, 1, 2).float() / 255.0,
            parts=self._parts[index],
            shape_code=self._shape_code[index],
            appearance_code=self._appearance_code[index],
            gaze=self._gaze[index],
            rays_o=self._position[index].float()[:, None].expand(-1, n_rays, -1),
            rays_d=self._directions(index, rays),
            rays=rays,
            valid=torch.arange(n_rays, device=self.device)[None] < counts[:, :1],
            distance=per_ray["distance"],
            has_surface=per_ray["has_surface"],
            face_coverage=per_ray["face_coverage"],
            eyes_coverage=per_ray["eyes_coverage"],
            eye_rays=self._eye_rays[index, :n_eyes].long(),
            eye_valid=torch.arange(n_eyes, device=self.device)[None] < counts[:, 1:],
            eye_corner=self._eye_corner[index],
            free_d=self._directions(index, free_pixels),
            free_limit=limit.gather(1, free_pixels),
            eye_centres=self._centres[index] if known else None,
            eye_radius=float(np.mean([eye[1] for eye in eyes])) if known else 0.0,
        )

    def _directions(self, index: torch.Tensor, pixels: torch.Tensor) -> torch.Tensor:
        """(B, N, 3) float32 unit world directions through flat feature pixels (B, N), computed in float64."""
        fx, fy, cx, cy = (value[:, None] for value in self._intrinsics[index].unbind(1))
        column, row = pixels % self.feature_size, pixels.div(self.feature_size, rounding_mode="floor")
        x, y = (column + self.ray_offset - cx) / fx, (row + self.ray_offset - cy) / fy
        directions = torch.stack([x, y, torch.ones_like(x)], dim=-1)
        directions = directions / directions.norm(dim=-1, keepdim=True)
        return (directions @ self._rotation[index].transpose(1, 2)).float()


def device_bytes(maker: BatchMaker) -> int:
    """What a `DeviceBatchMaker` of these captures keeps on its device, in bytes."""
    first: RayTargets = maker.targets[0]
    n_rays = max(target.rays.size for target in maker.targets)
    n_eyes = max(1, *(target.eye_rays.size for target in maker.targets))
    per_ray = sum(getattr(first, name).itemsize for name in PER_RAY)
    pictures = maker.captures[0].image.nbytes + maker.captures[0].parts.nbytes
    return len(maker) * (pictures + n_rays * per_ray + n_eyes * first.eye_rays.itemsize)


def _table(values: list[np.ndarray]) -> torch.Tensor:
    """Rows of one length, each continued by its last value (0 where it has none)."""
    out = np.zeros((len(values), max(1, *(value.size for value in values))), dtype=values[0].dtype)
    for row, value in zip(out, values, strict=True):
        row[: value.size] = value
        if value.size:
            row[value.size :] = value[-1]
    return torch.from_numpy(out)


def _pile(arrays: list[np.ndarray], device: torch.device) -> torch.Tensor:
    """Arrays of one shape copied into one tensor one after another, so that the host never holds them twice."""
    out = torch.empty((len(arrays), *arrays[0].shape), dtype=torch.from_numpy(arrays[0][:1]).dtype, device=device)
    for row, array in zip(out, arrays, strict=True):
        row.copy_(torch.from_numpy(array))
    return out
