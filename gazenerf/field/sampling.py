"""Where rays are sampled: world-z slabs as published, by distance through a box, or in a shell.

Every sampler returns `RaySamples`.
"""

from __future__ import annotations

from typing import NamedTuple

import torch

from gazenerf.field.config import FieldConfig


class RaySamples(NamedTuple):
    """Samples of rays.

    Attributes:
        t: (R, S) distances along unit rays, increasing, world units.
        deltas: (R, S) lengths of the intervals that the samples stand for, world units.
    """

    t: torch.Tensor
    deltas: torch.Tensor


def slab_samples(rays_o: torch.Tensor, rays_d: torch.Tensor, config: FieldConfig, jitter: bool = False) -> RaySamples:
    """Samples at evenly spaced world z, as published.

    `config.samples` + 1 edges run from `z_near` to `z_far`; the last one is dropped for positions.
    Rays at right angles to the z axis are undefined. With `jitter` each edge moves at random
    between the middles of its neighbours.

    Args:
        rays_o, rays_d: (R, 3), unit directions.
    """
    edges = torch.linspace(config.z_near, config.z_far, config.samples + 1, device=rays_o.device)
    edges = edges.expand(rays_o.shape[0], -1)
    if jitter:
        middle = 0.5 * (edges[:, 1:] + edges[:, :-1])
        upper = torch.cat([edges[:, :1], middle], dim=1)
        lower = torch.cat([middle, edges[:, -1:]], dim=1)
        edges = upper + (lower - upper) * torch.rand_like(edges)
    slope = rays_d[:, 2:]
    t = (edges - rays_o[:, 2:]) / torch.where(slope.abs() < 1e-6, torch.full_like(slope, -1e-6), slope)
    return RaySamples(t[:, :-1], (t[:, 1:] - t[:, :-1]).abs())


def box_interval(rays_o: torch.Tensor, rays_d: torch.Tensor, box: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Distances (R,) at which rays enter and leave a box (2, 3); entry equals exit where they miss."""
    slope = torch.where(rays_d.abs() < 1e-9, torch.full_like(rays_d, 1e-9), rays_d)
    a, b = (box[0] - rays_o) / slope, (box[1] - rays_o) / slope
    near = torch.minimum(a, b).amax(-1).clamp(min=0.0)
    far = torch.maximum(a, b).amin(-1)
    return near, torch.maximum(far, near)


def ray_samples(
    rays_o: torch.Tensor, rays_d: torch.Tensor, box: torch.Tensor, count: int, jitter: bool = False
) -> RaySamples:
    """Samples evenly spaced by distance through a box (2, 3), for rays of any direction."""
    near, far = box_interval(rays_o, rays_d, box)
    return interval_samples(near, far, count, jitter)


def shell_samples(distance: torch.Tensor, half_width: float, count: int, jitter: bool = False) -> RaySamples:
    """Samples within `half_width` of a distance (R,) along each ray, evenly spaced."""
    return interval_samples(distance - half_width, distance + half_width, count, jitter)


def interval_samples(near: torch.Tensor, far: torch.Tensor, count: int, jitter: bool = False) -> RaySamples:
    """One sample in each of `count` equal intervals between near (R,) and far (R,).

    In the middle of its interval, or anywhere in it with `jitter`. A sample's delta is the distance
    to the next one; the last takes the interval's length.
    """
    step = ((far - near) / count)[:, None]
    place = torch.arange(count, device=near.device, dtype=near.dtype)[None]
    offset = torch.rand(near.shape[0], count, device=near.device) if jitter else 0.5
    t = near[:, None] + (place + offset) * step
    return RaySamples(t, torch.cat([t[:, 1:] - t[:, :-1], step], dim=1))
