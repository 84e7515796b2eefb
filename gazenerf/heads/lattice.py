"""Density of a bound head on a lattice around its surface, where rays find that surface without the network.

Before its activation the density is close to linear over half an occupancy cell, so what is interpolated is
what was activated, not the density: the inverse softplus of it, or the signed distance where the density
follows from one. Densities of distances are steps, which a lattice would turn into stairs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from scipy import ndimage

from gazenerf.field.distance import DEEPEST, laplace_density, laplace_distance
from gazenerf.field.sampling import box_interval
from gazenerf.field.streams import SOFTPLUS_GAIN
from gazenerf.heads.march import first_surface
from gazenerf.heads.occupancy import OPAQUE, Occupancy

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
        device, density = occupancy.box.device, occupancy.density.cpu().numpy()
        step = ((occupancy.box[1] - occupancy.box[0]) / len(density)).cpu().numpy()
        open_cells = np.pad(density <= OPAQUE, 1, constant_values=True)
        labels = np.asarray(ndimage.label(open_cells)[0])  # pyright: ignore[reportIndexIssue]
        outside = (labels == labels[0, 0, 0])[1:-1, 1:-1, 1:-1]
        depth = np.asarray(ndimage.distance_transform_edt(~outside, sampling=step))
        close = ndimage.binary_dilation(density > THIN, np.ones((3, 3, 3)))
        if unsure is not None:
            close |= unsure.cpu().numpy()
        near = (depth <= DEPTH) & (close | ~outside)
        cells, free = torch.from_numpy(near).to(device), torch.from_numpy(outside).to(device)
        return cls(_vertices(cells).nonzero(), _nearest(~free), ~cells & free, occupancy.box)

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
    index = (torch.arange(2 * len(cells) + 1, device=cells.device) // 2).clamp(max=len(cells) - 1)
    return cells[index][:, index][:, :, index]


class DensityLattice:
    """Trilinear density around a surface.

    Args:
        band: Where.
        density: (V,) at the band's points.
        spread: `BoundField.surface_spread`, where density follows from signed distances.
    """

    def __init__(self, band: Band, density: torch.Tensor, spread: float | None = None) -> None:
        self.spread = spread
        if spread is None:
            raw = torch.where(band.inside, FULL, EMPTY)
            raw[tuple(band.vertices.T)] = to_raw(density)
        else:
            raw = torch.where(band.inside, -DEEPEST * spread, DEEPEST * spread)
            raw[tuple(band.vertices.T)] = laplace_distance(density.float(), spread)
        self.raw = raw[None, None].contiguous()
        self.box = band.box
        self.extent = band.box[1] - band.box[0]
        step = self.extent / len(band.empty)
        skip = np.asarray(ndimage.distance_transform_edt(band.empty.cpu().numpy(), sampling=step.cpu().numpy()))
        skip = torch.from_numpy(skip.astype(np.float32)).to(band.box.device)
        self.skip = (skip - float(step.norm())).clamp(min=0.0)

    @property
    def nbytes(self) -> int:
        """Memory of the lattice, bytes."""
        return self.raw.nbytes + self.skip.nbytes

    def density(self, points: torch.Tensor) -> torch.Tensor:
        """(...) per world unit at points (..., 3); the lattice's border beyond its box."""
        place = (2.0 * (points - self.box[0]) / self.extent - 1.0).flip(-1).reshape(1, 1, 1, -1, 3)
        raw = F.grid_sample(self.raw, place, align_corners=True, padding_mode="border").reshape(points.shape[:-1])
        return SOFTPLUS_GAIN * F.softplus(raw) if self.spread is None else laplace_density(raw, self.spread)

    def first_surface(
        self, rays_o: torch.Tensor, rays_d: torch.Tensor, start: torch.Tensor | None = None
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """See `gazenerf.heads.march.first_surface`; the network is not queried.

        `start` (R,) is the distance from which a surface is looked for.
        """
        return first_surface(self.density, LeapingSteps(self, rays_o, rays_d, start=start), rays_o, rays_d)


class LeapingSteps:
    """Even samples through a lattice's box that leap over empty space; see `gazenerf.heads.march.Steps`.

    Args:
        lattice: Of the density that is looked for.
        rays_o, rays_d: (R, 3).
        count: Samples through the box.
        size: Samples per ray and block.
        start: (R,) distance from which there are samples; the box's own when None.
    """

    def __init__(
        self,
        lattice: DensityLattice,
        rays_o: torch.Tensor,
        rays_d: torch.Tensor,
        count: int = 96,
        size: int = 6,
        start: torch.Tensor | None = None,
    ) -> None:
        self._near, self._far = box_interval(rays_o, rays_d, lattice.box)
        self.width = ((self._far - self._near) / count).clamp(min=1e-9)
        from_here = self._near if start is None else torch.minimum(torch.maximum(self._near, start), self._far)
        cells = lattice.skip.shape[0]
        scale = cells / lattice.extent
        self._start, self._slope = (rays_o - lattice.box[0]) * scale, rays_d * scale
        self._skip, self._cells, self._count = lattice.skip.reshape(-1), cells, count
        self._within = torch.arange(size, device=rays_o.device) + 0.5
        everything = torch.arange(len(rays_o), device=rays_o.device)
        self._number = ((self._leap(everything, from_here, 12) - self._near) / self.width).floor()

    def _leap(self, rays: torch.Tensor, t: torch.Tensor, rounds: int) -> torch.Tensor:
        """Distances (A,) moved along rays (A,) over what is known to be empty."""
        start, slope, far, size = self._start[rays], self._slope[rays], self._far[rays], self._cells
        for _ in range(rounds):
            cell = (start + t[:, None] * slope).int().clamp_(0, size - 1)
            index = (cell[:, 0] * size + cell[:, 1]) * size + cell[:, 2]
            t = torch.minimum(t + self._skip.index_select(0, index), far)
        return t

    def first(self) -> torch.Tensor:
        """Rays that do not leap through the whole box."""
        return (self._number < self._count).nonzero()[:, 0]

    def block(self, rays: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """The next samples, one after another."""
        t = self._near[rays, None] + (self._number[rays, None] + self._within) * self.width[rays, None]
        return t, t < self._far[rays, None]

    def ahead(self, rays: torch.Tensor, hit: torch.Tensor) -> torch.Tensor:
        """The rays that have met no surface and are still inside the box after a leap."""
        rays = rays[~hit]
        near, width, after = self._near[rays], self.width[rays], self._number[rays] + len(self._within)
        t = self._leap(rays, near + after * width, 3)
        self._number[rays] = torch.maximum(after, ((t - near) / width).floor())
        return rays[self._number[rays] < self._count]
