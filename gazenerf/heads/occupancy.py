"""Where a bound density can be: a boolean grid, and rays walked through it front to back."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
import torch.nn.functional as F

from gazenerf.field.sampling import box_interval

Density = Callable[[torch.Tensor], torch.Tensor]
"""Points (N, 3) to density (N,)."""


@dataclass(frozen=True)
class Occupancy:
    """A grid over a box: True where density may exceed a threshold, grown by a margin.

    Attributes:
        cells: (G, G, G) bool, indexed [x, y, z].
        box: (2, 3) float32.
        density: (G, G, G) float32 per world unit at the cells' centres, as sampled.
    """

    cells: torch.Tensor
    box: torch.Tensor
    density: torch.Tensor

    @classmethod
    def of(
        cls,
        density: Density,
        box: torch.Tensor,
        size: int = 64,
        threshold: float = 0.5,
        margin: int = 2,
        within: torch.Tensor | None = None,
    ) -> Occupancy:
        """Sample a density at the cell centres and grow what exceeds the threshold (per world unit) by `margin` cells.

        The default margin, about 9 mm for the bundled box, covers how far lids move with the gaze.
        `within` (2, 3) is a box outside which the density is known to be 0 and not asked for.
        """
        step = (box[1] - box[0]) / size
        axes = [box[0, i] + step[i] * (torch.arange(size) + 0.5) for i in range(3)]
        low, high = [0] * 3, [size] * 3
        if within is not None:
            low = [int((axes[i] < within[0, i]).sum()) for i in range(3)]
            high = [int((axes[i] <= within[1, i]).sum()) for i in range(3)]
        values = torch.zeros(size, size, size)
        y, z = (axes[i][low[i] : high[i]] for i in (1, 2))
        for first in range(low[0], high[0], 8):
            x = axes[0][first : min(first + 8, high[0])]
            found = density(torch.cartesian_prod(x, y, z)).reshape(len(x), len(y), len(z))
            values[first : first + len(x), low[1] : high[1], low[2] : high[2]] = found
        dense = values > threshold
        grown = F.max_pool3d(dense[None, None].float(), 2 * margin + 1, stride=1, padding=margin)[0, 0] > 0
        return cls(grown, box, values)

    @classmethod
    def union(cls, parts: Sequence[Occupancy]) -> Occupancy:
        """What any of some occupancies of one box holds, with the sum of their densities."""
        cells, density = parts[0].cells, parts[0].density
        for part in parts[1:]:
            cells, density = cells | part.cells, density + part.density
        return cls(cells, parts[0].box, density)

    @property
    def share(self) -> float:
        """Occupied share of the box."""
        return float(self.cells.float().mean())

    def bounds(self) -> torch.Tensor | None:
        """(2, 3) smallest box around the occupied cells, None when there are none."""
        found = self.cells.nonzero()
        if not len(found):
            return None
        step = (self.box[1] - self.box[0]) / self.cells.shape[0]
        return torch.stack([self.box[0] + step * found.amin(0), self.box[0] + step * (found.amax(0) + 1)])

    def at(self, points: torch.Tensor) -> torch.Tensor:
        """(...,) bool: is each point (..., 3) in an occupied cell; False outside the box."""
        size = self.cells.shape[0]
        place = (points - self.box[0]) / (self.box[1] - self.box[0]) * size
        inside = ((place >= 0) & (place < size)).all(dim=-1)
        index = place.long().clamp(0, size - 1)
        return self.cells[index[..., 0], index[..., 1], index[..., 2]] & inside


def first_surface(
    density: Density,
    occupancy: Occupancy,
    rays_o: torch.Tensor,
    rays_d: torch.Tensor,
    steps: int = 96,
    block: int = 4,
    refinements: int = 1,
    least: float = 0.1,
    window: tuple[torch.Tensor, torch.Tensor] | None = None,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Distance at which half the light of each ray is gone, or where it loses most if it never loses half.

    The second kind are the rays that graze an outline; with them a picture's edge is not a staircase.

    Rays are stepped evenly through the box; only samples in occupied cells are asked for their
    density, a block at a time, and a ray stops once it is opaque. The interval found is then
    sampled more finely.

    Args:
        density: The bound density.
        occupancy: Of that density.
        rays_o, rays_d: (R, 3).
        steps: Even steps through the box.
        block: Samples a ray and round.
        refinements: How often the interval is divided by eight.
        least: A ray that loses a smaller share of its light hits nothing.
        window: Nearest and farthest distance (R,) that are looked at; the whole box when None.

    Returns:
        distance (R,), meaningless where `hit` is False, and hit (R,) bool.
    """
    count = len(rays_o)
    near, far = box_interval(rays_o, rays_d, occupancy.box)
    step = ((far - near) / steps).clamp(min=1e-9)
    t = near[:, None] + (torch.arange(steps) + 0.5) * step[:, None]
    occupied = occupancy.at(rays_o[:, None] + t[..., None] * rays_d[:, None])
    if window is not None:
        occupied &= (t >= window[0][:, None]) & (t <= window[1][:, None])
    order = torch.argsort((~occupied).to(torch.uint8), dim=1, stable=True)
    numbers = occupied.sum(1)
    t = t.gather(1, order)
    passed = torch.ones(count)
    distance = torch.full((count,), torch.nan)
    grazed, most = torch.zeros(count), torch.zeros(count)
    for start in range(0, int(numbers.max()) if count else 0, block):
        alive = ((numbers > start) & distance.isnan()).nonzero()[:, 0]
        if not len(alive):
            break
        here = t[alive, start : start + block]
        used = (torch.arange(start, start + here.shape[1]) < numbers[alive, None]).float()
        points = rays_o[alive, None] + here[..., None] * rays_d[alive, None]
        alpha = 1.0 - torch.exp(-density(points.reshape(-1, 3)).reshape(here.shape) * step[alive, None])
        left = passed[alive, None] * torch.cumprod(1.0 - alpha * used, dim=1)
        crossed = left < 0.5
        which = crossed.float().argmax(1)
        hit = crossed.any(1)
        index = alive[hit]
        distance[index] = here[hit, which[hit]]
        lost, where = (torch.cat([passed[alive, None], left[:, :-1]], dim=1) - left).max(1)
        more = lost > most[alive]
        most[alive[more]] = lost[more]
        grazed[alive[more]] = here.gather(1, where[:, None])[more, 0]
        passed[alive] = left[:, -1]
    distance = torch.where(distance.isnan() & (passed < 1.0 - least), grazed, distance)
    found = ~distance.isnan()
    rays = found.nonzero()[:, 0]
    place, width = distance[rays], step[rays]
    for _ in range(refinements):
        place, width = refine(density, rays_o[rays], rays_d[rays], place, width)
    distance[rays] = place
    return distance, found


def refine(
    density: Density,
    rays_o: torch.Tensor,
    rays_d: torch.Tensor,
    distance: torch.Tensor,
    width: torch.Tensor,
    parts: int = 8,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Where half the light is gone within a step of distances (R,), or where the density is greatest.

    Args:
        density: The bound density.
        rays_o, rays_d: (R, 3).
        distance, width: (R,) a sample where it happened, and the step between samples.
        parts: Samples over two steps.

    Returns:
        distance (R,) and the new step (R,).
    """
    fine = width * 2 / parts
    here = (distance - 1.5 * width)[:, None] + (torch.arange(parts) + 0.5) * fine[:, None]
    points = rays_o[:, None] + here[..., None] * rays_d[:, None]
    alpha = 1.0 - torch.exp(-density(points.reshape(-1, 3)).reshape(here.shape) * fine[:, None])
    crossed = torch.cumprod(1.0 - alpha, dim=1) < 0.5
    which = torch.where(crossed.any(1), crossed.float().argmax(1), alpha.argmax(1))
    return here.gather(1, which[:, None])[:, 0], fine
