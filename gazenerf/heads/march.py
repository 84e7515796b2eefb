"""Rays walked front to back to the first surface of a density.

There is one search. What differs is which samples it looks at: those in occupied cells of a coarse
grid (`occupancy.OccupiedSteps`), or those left after empty space is leapt over
(`lattice.LeapingSteps`).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import torch

Density = Callable[[torch.Tensor], torch.Tensor]
"""Points (N, 3) to density (N,), per world unit."""

CHUNK = 2**13
"""Points queried at once. Larger arrays come fresh from the system every time, which costs a third of the time."""

OPAQUE_SHARE = 0.5
"""A surface lies where so much of a ray's light is gone."""

LEAST_LOST = 0.1
"""Share of its light that a ray has to lose to hit anything."""

REFINED = 8
"""Samples over two steps around a surface that was found."""


class Steps(Protocol):
    """Evenly spaced samples of rays, handed out a block at a time.

    Attributes:
        width: (R,) distance between the samples of each ray, world units.
    """

    width: torch.Tensor

    def first(self) -> torch.Tensor:
        """(A,) numbers of the rays that have samples to look at."""
        ...

    def block(self, rays: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Distances (A, B) of the next samples of some rays, and (A, B) bool which of them count."""
        ...

    def ahead(self, rays: torch.Tensor, hit: torch.Tensor) -> torch.Tensor:
        """Moves past the block and returns those of the rays (A,) that go on; `hit` (A,) have found a surface."""
        ...


def first_surface(
    density: Density, steps: Steps, rays_o: torch.Tensor, rays_d: torch.Tensor, least: float = LEAST_LOST
) -> tuple[torch.Tensor, torch.Tensor]:
    """Distance at which half the light of each ray is gone, or where it loses most if it never loses half.

    The second kind are the rays that graze an outline; with them a picture's edge is not a staircase.
    The interval found is then sampled more finely.

    Args:
        density: What is looked for.
        steps: The samples of these rays.
        rays_o, rays_d: (R, 3), unit directions.
        least: A ray that loses a smaller share of its light hits nothing.

    Returns:
        distance (R,) world units, meaningless where `hit` is False, and hit (R,) bool.
    """
    count = len(rays_o)
    passed, distance = rays_o.new_ones(count), rays_o.new_full((count,), torch.nan)
    grazed, most = rays_o.new_zeros(count), rays_o.new_zeros(count)
    rays = steps.first()
    while len(rays):
        t, counts = steps.block(rays)
        points = rays_o[rays, None] + t[..., None] * rays_d[rays, None]
        found = density(points.reshape(-1, 3)).reshape(t.shape)
        alpha = 1.0 - torch.exp(-found * steps.width[rays, None])
        before = passed[rays, None]
        left = before * torch.cumprod(1.0 - alpha * counts, dim=1)
        crossed = left < OPAQUE_SHARE
        hit = crossed[:, -1]
        distance[rays[hit]] = t[hit].gather(1, crossed[hit].float().argmax(1)[:, None])[:, 0]
        lost, place = (torch.cat([before, left[:, :-1]], dim=1) - left).max(1)
        more = lost > most[rays]
        most[rays[more]] = lost[more]
        grazed[rays[more]] = t[more].gather(1, place[more, None])[:, 0]
        passed[rays] = left[:, -1]
        rays = steps.ahead(rays, hit)
    distance = torch.where(distance.isnan() & (passed < 1.0 - least), grazed, distance)
    seen = ~distance.isnan()
    rays = seen.nonzero()[:, 0]
    distance[rays] = refined(density, rays_o[rays], rays_d[rays], distance[rays], steps.width[rays])
    return distance, seen


def refined(
    density: Density,
    rays_o: torch.Tensor,
    rays_d: torch.Tensor,
    distance: torch.Tensor,
    width: torch.Tensor,
) -> torch.Tensor:
    """(R,) where half the light is gone within a step of distances (R,), or where the density is greatest.

    Args:
        density: What is looked for.
        rays_o, rays_d: (R, 3).
        distance, width: (R,) a sample where it happened, and the distance between samples.
    """
    fine = width * 2 / REFINED
    here = (distance - 1.5 * width)[:, None] + (torch.arange(REFINED, device=width.device) + 0.5) * fine[:, None]
    points = rays_o[:, None] + here[..., None] * rays_d[:, None]
    alpha = 1.0 - torch.exp(-density(points.reshape(-1, 3)).reshape(here.shape) * fine[:, None])
    crossed = torch.cumprod(1.0 - alpha, dim=1) < OPAQUE_SHARE
    which = torch.where(crossed.any(1), crossed.float().argmax(1), alpha.argmax(1))
    return here.gather(1, which[:, None])[:, 0]
