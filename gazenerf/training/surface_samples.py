"""Where the rays of a batch are sampled when the field knows distances: around its own surfaces.

Its densities rise within a fraction of a millimetre. Samples around the captured surface, which lies elsewhere
by as much, would stand so far apart that one of them, at a random depth below the surface, gave the whole colour.
"""

from __future__ import annotations

import torch

from gazenerf.field.model import TwoStreamField
from gazenerf.field.sampling import RaySamples, interval_samples
from gazenerf.field.streams import StreamCondition
from gazenerf.training.batches import Batch
from gazenerf.training.geometry_terms import pick

STEPS = 4
"""Steps by the distance itself that lead from the captured surface to the field's."""

REACH = 0.15
"""World units, at most, between the two; a ray that meets no surface stays within it."""


def surface_samples(
    model: TwoStreamField,
    batch: Batch,
    conditions: dict[str, StreamCondition],
    half_width: float,
    count: int,
    jitter: bool,
) -> RaySamples:
    """Samples (B, R, S) of a batch's rays around the surfaces of a field of distances.

    Rays near an eye are sampled around both streams' surfaces, half of the samples each and as densely, so that an
    eyeball is seen past the edge of a lid.

    Args:
        model: Of geometry `distance`.
        batch: Its captured surfaces are where the search begins.
        conditions: Of the streams `face` and `eyes`.
        half_width: Of the samples around a surface, world units, on rays away from the eyes.
        count: Samples per ray, at least 2.
        jitter: Stratified samples; the middle of each interval otherwise.
    """
    step = 2.0 * half_width / count
    face = _to_surface(model, "face", conditions["face"], batch.rays_o, batch.rays_d, batch.distance)
    t = _around(face, half_width, count, jitter)
    near = pick(batch.rays_o, batch.eye_rays), pick(batch.rays_d, batch.eye_rays), pick(batch.distance, batch.eye_rays)
    eyes = _to_surface(model, "eyes", conditions["eyes"], *near)
    first = count // 2
    of_face = _around(pick(face, batch.eye_rays), 0.5 * first * step, first, jitter)
    of_eyes = _around(eyes, 0.5 * (count - first) * step, count - first, jitter)
    both = torch.cat([of_face, of_eyes], dim=-1).sort(-1).values
    t = t.scatter(1, batch.eye_rays[..., None].expand_as(both), both)
    apart = torch.cat([t[..., 1:] - t[..., :-1], torch.full_like(t[..., :1], step)], dim=-1)
    return RaySamples(t, apart.clamp(max=2.0 * step))  # what lies between two surfaces is no sample's


@torch.no_grad()
def _to_surface(
    model: TwoStreamField,
    name: str,
    condition: StreamCondition,
    rays_o: torch.Tensor,
    rays_d: torch.Tensor,
    distance: torch.Tensor,
) -> torch.Tensor:
    """Distances (B, R) along rays at which a stream's surface is, searched from others."""
    t = distance
    for _ in range(STEPS):
        points = rays_o + t[..., None] * rays_d
        t = t + model.signed_distance(name, points, condition)
        t = torch.minimum(torch.maximum(t, distance - REACH), distance + REACH)
    return t


def _around(t: torch.Tensor, half_width: float, count: int, jitter: bool) -> torch.Tensor:
    """(B, R, S) within a half width of (B, R)."""
    flat = t.reshape(-1)
    return interval_samples(flat - half_width, flat + half_width, count, jitter).t.reshape(*t.shape, count)
