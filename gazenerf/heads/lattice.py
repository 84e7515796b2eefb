"""Density of a bound head on a lattice around its surface, and rays that find that surface without the network.

Before its activation the density is close to linear over half an occupancy cell, so what is
interpolated is the inverse softplus of the density, not the density.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from scipy import ndimage

from gazenerf.field.sampling import box_interval
from gazenerf.field.streams import SOFTPLUS_GAIN
from gazenerf.heads.occupancy import Occupancy, refine

OPAQUE = 8.0
"""Density per world unit from which a cell hides what is behind it; what lies outside such cells is seen."""

DEPTH = 0.08
"""World units below the first opaque cells that are kept; deeper, less than a hundredth of the light is left."""

THIN = 0.5
"""Density per world unit below which a cell counts as empty if its neighbours do too."""

EMPTY, FULL = -16.0, 10.0
"""Before the activation: nothing, and opaque within a hundredth of a unit."""


def to_raw(density: torch.Tensor) -> torch.Tensor:
    """Inverse of the softplus activation; `EMPTY` at least."""
    scaled = (density.double() / SOFTPLUS_GAIN).clamp(min=1e-7)
    return (scaled + torch.log(-torch.expm1(-scaled))).float().clamp(min=EMPTY)


@dataclass(frozen=True)
class Band:
    """Where an occupancy's surface can be seen, on a lattice of half its cells.

    Attributes:
        vertices: (V, 3) indices into the lattice (2 G + 1)^3.
        inside: (2 G + 1)^3 bool: covered by what is opaque.
        empty: (G, G, G) bool cells with nothing in them.
        box: (2, 3).
    """

    vertices: torch.Tensor
    inside: torch.Tensor
    empty: torch.Tensor
    box: torch.Tensor

    @classmethod
    def of(cls, occupancy: Occupancy, unsure: torch.Tensor | None = None) -> Band:
        """The band of an occupancy.

        Args:
            occupancy: With the densities it was made from.
            unsure: (G, G, G) bool cells whose density may have changed since.
        """
        density = occupancy.density.numpy()
        step = ((occupancy.box[1] - occupancy.box[0]) / len(density)).numpy()
        free = np.pad(density <= OPAQUE, 1, constant_values=True)
        labels = np.asarray(ndimage.label(free)[0])  # pyright: ignore[reportIndexIssue]
        outside = (labels == labels[0, 0, 0])[1:-1, 1:-1, 1:-1]
        depth = np.asarray(ndimage.distance_transform_edt(~outside, sampling=step))
        close = ndimage.binary_dilation(density > THIN, np.ones((3, 3, 3)))
        if unsure is not None:
            close |= unsure.numpy()
        near = (depth <= DEPTH) & (close | ~outside)
        cells = torch.from_numpy(near)
        return cls(
            _vertices(cells).nonzero(),
            _nearest(torch.from_numpy(~outside)),
            ~cells & torch.from_numpy(outside),
            occupancy.box,
        )

    @property
    def points(self) -> torch.Tensor:
        """(V, 3) world positions of the vertices."""
        return self.box[0] + self.vertices * (self.box[1] - self.box[0]) / (self.inside.shape[0] - 1)


def _vertices(cells: torch.Tensor) -> torch.Tensor:
    """(2 G + 1)^3 bool: vertices of half cells of the cells (G, G, G)."""
    fine = cells.repeat_interleave(2, 0).repeat_interleave(2, 1).repeat_interleave(2, 2)
    return F.max_pool3d(F.pad(fine[None, None].float(), (1,) * 6), 2, stride=1)[0, 0] > 0


def _nearest(cells: torch.Tensor) -> torch.Tensor:
    """(2 G + 1)^3 bool: the value of a cell (G, G, G) that each vertex belongs to."""
    index = (torch.arange(2 * len(cells) + 1) // 2).clamp(max=len(cells) - 1)
    return cells[index][:, index][:, :, index]


class DensityLattice:
    """Trilinear density around a surface.

    Args:
        band: Where.
        density: (V,) at the band's points.
    """

    def __init__(self, band: Band, density: torch.Tensor) -> None:
        raw = torch.where(band.inside, FULL, EMPTY)
        raw[tuple(band.vertices.T)] = to_raw(density)
        self.raw = raw[None, None].contiguous()
        self.box = band.box
        self.extent = band.box[1] - band.box[0]
        step = self.extent / len(band.empty)
        skip = torch.from_numpy(ndimage.distance_transform_edt(band.empty.numpy(), sampling=step.numpy())).float()
        self.skip = (skip - float(step.norm())).clamp(min=0.0)

    @property
    def nbytes(self) -> int:
        """Memory of the lattice, bytes."""
        return self.raw.nbytes + self.skip.nbytes

    def density(self, points: torch.Tensor) -> torch.Tensor:
        """(...) per world unit at points (..., 3); the lattice's border beyond its box."""
        place = (2.0 * (points - self.box[0]) / self.extent - 1.0).flip(-1).reshape(1, 1, 1, -1, 3)
        raw = F.grid_sample(self.raw, place, align_corners=True, padding_mode="border")
        return SOFTPLUS_GAIN * F.softplus(raw).reshape(points.shape[:-1])

    def _advance(
        self, t: torch.Tensor, rays_o: torch.Tensor, rays_d: torch.Tensor, far: torch.Tensor, rounds: int
    ) -> torch.Tensor:
        """Move t (R,) along rays over what is known to be empty."""
        size = self.skip.shape[0]
        scale = size / self.extent
        start, slope = (rays_o - self.box[0]) * scale, rays_d * scale
        skip = self.skip.reshape(-1)
        for _ in range(rounds):
            cell = (start + t[:, None] * slope).int().clamp_(0, size - 1)
            t = torch.minimum(t + skip.index_select(0, (cell[:, 0] * size + cell[:, 1]) * size + cell[:, 2]), far)
        return t

    def first_surface(
        self, rays_o: torch.Tensor, rays_d: torch.Tensor, steps: int = 96, block: int = 6, least: float = 0.1
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """See `gazenerf.heads.occupancy.first_surface`: the same steps, from the lattice, over empty space at once."""
        near, far = box_interval(rays_o, rays_d, self.box)
        step = ((far - near) / steps).clamp(min=1e-9)
        count = len(rays_o)
        distance = torch.full((count,), torch.nan)
        grazed, most, passed = torch.zeros(count), torch.zeros(count), torch.ones(count)
        t = self._advance(near, rays_o, rays_d, far, 12)
        number = ((t - near) / step).floor()
        alive = (number < steps).nonzero()[:, 0]
        within = torch.arange(block) + 0.5
        while len(alive):
            o, d, width = rays_o[alive], rays_d[alive], step[alive]
            here = near[alive, None] + (number[alive, None] + within) * width[:, None]
            alpha = 1.0 - torch.exp(-self.density(o[:, None] + here[..., None] * d[:, None]) * width[:, None])
            before = passed[alive, None]
            left = before * torch.cumprod(1.0 - alpha * (here < far[alive, None]), dim=1)
            crossed = left < 0.5
            hit = crossed[:, -1]
            distance[alive[hit]] = here[hit].gather(1, crossed[hit].float().argmax(1)[:, None])[:, 0]
            lost, where = (torch.cat([before, left[:, :-1]], dim=1) - left).max(1)
            more = lost > most[alive]
            most[alive[more]] = lost[more]
            grazed[alive[more]] = here[more].gather(1, where[more, None])[:, 0]
            passed[alive] = left[:, -1]
            t = self._advance(near[alive] + (number[alive] + block) * width, o, d, far[alive], 3)
            number[alive] = torch.maximum(number[alive] + block, ((t - near[alive]) / width).floor())
            alive = alive[~hit & (number[alive] < steps)]
        distance = torch.where(distance.isnan() & (passed < 1.0 - least), grazed, distance)
        found = ~distance.isnan()
        rays = found.nonzero()[:, 0]
        distance[rays] = refine(self.density, rays_o[rays], rays_d[rays], distance[rays], step[rays])[0]
        return distance, found
