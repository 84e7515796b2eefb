"""A bound head baked: density and features on a lattice around its surface, frames by interpolation.

Features do not depend on the view, so what the network says at the lattice's vertices serves every
camera: a frame costs a walk through the lattice, weighted sums of its rows and one up-sampler pass.
Only along rays that meet the occupied cells of the eyes the network is queried anew: lids lie closer to
eyeballs than the lattice's vertices to each other, and would be drawn as pale as these. Lids and eyeballs are
therefore exact at every gaze, and only the little that the gaze changes in the rest of the face is lost.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch
import torch.nn.functional as F

from gazenerf.errors import UserError
from gazenerf.field.compositing import composite
from gazenerf.field.sampling import shell_samples
from gazenerf.geometry import Camera, Gaze
from gazenerf.geometry.paths import GazeRange
from gazenerf.heads.batches import Drawn, FrameBatches, PictureRays, Rays, draw_rays
from gazenerf.heads.bound import BoundHead
from gazenerf.heads.feature_map import RayFeatures, Window
from gazenerf.heads.head import Head
from gazenerf.heads.interface import OPACITY_FLOOR, GeometryView, Part, RenderedView
from gazenerf.heads.lattice import Band, DensityLattice
from gazenerf.heads.occupancy import Occupancy
from gazenerf.heads.render import composite_near
from gazenerf.progress import Progress, counted, silent
from gazenerf.workers import workers_for

FAINT = 1e-3
"""Samples of less weight are left out; the others share theirs."""

CORNERS = torch.tensor([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])


@dataclass(frozen=True)
class BakeReport:
    """What a bake cost.

    Attributes:
        seconds: Wall time.
        vertices: Lattice vertices at which the network was queried.
        nbytes: Memory kept.
        gaze: What it was baked for.
    """

    seconds: float
    vertices: int
    nbytes: int
    gaze: Gaze


class FeatureLattice:
    """Features at the band's vertices, in rows.

    Args:
        band: Where; features: (V, C) there.
    """

    def __init__(self, band: Band, features: torch.Tensor) -> None:
        self.size = band.inside.shape[0]
        device = features.device
        row = torch.zeros(self.size**3, dtype=torch.int32, device=device)
        row[self._flat(band.vertices)] = torch.arange(1, len(features) + 1, dtype=torch.int32, device=device)
        self.row = row
        self.table = torch.cat([features.new_zeros(1, features.shape[1]), features])
        self.low, self.scale = band.box[0], (self.size - 1) / (band.box[1] - band.box[0])
        self.corners = self._flat(CORNERS.to(device))

    def _flat(self, index: torch.Tensor) -> torch.Tensor:
        return (index[..., 0] * self.size + index[..., 1]) * self.size + index[..., 2]

    @property
    def nbytes(self) -> int:
        """Memory of the rows and their index, bytes."""
        return self.row.nbytes + self.table.nbytes

    def blend(
        self, points: torch.Tensor, weights: torch.Tensor, counts: torch.Tensor, total: torch.Tensor
    ) -> torch.Tensor:
        """Sums of weighted features along rays.

        Args:
            points: (N, 3), ray after ray.
            weights: (N,) of the points.
            counts: (R,) points per ray.
            total: (R,) what the weights of each ray are scaled to add up to.

        Returns:
            (R, C). Vertices that were not baked are left out; their weight goes to the others.
        """
        place = (points - self.low) * self.scale
        cell = place.floor().clamp_(0, self.size - 2)
        part = place - cell
        x, y, z = (torch.stack([1.0 - part[:, i], part[:, i]], dim=1) for i in range(3))
        share = (x[:, :, None, None] * y[:, None, :, None] * z[:, None, None, :]).reshape(-1, 8) * weights[:, None]
        rows = self.row.index_select(0, (self._flat(cell.long())[:, None] + self.corners).reshape(-1))
        share = share.reshape(-1) * (rows > 0)
        ends = 8 * counts.cumsum(0)
        offsets = torch.cat([ends.new_zeros(1), ends[:-1]])
        sums = torch.zeros_like(total).index_add_(
            0, torch.arange(len(counts), device=counts.device).repeat_interleave(8 * counts), share
        )
        found = F.embedding_bag(rows, self.table, offsets.int(), mode="sum", per_sample_weights=share)
        return found * (total / sums.clamp(min=1e-9))[:, None]


@dataclass(frozen=True)
class Bake:
    """Everything that frames of one subject share.

    Attributes:
        density, features: Lattices of the whole head, eyes included.
        eyes: Occupied cells of the eyes, whatever the gaze.
        report: What it cost.
    """

    density: DensityLattice
    features: FeatureLattice
    eyes: Occupancy
    report: BakeReport


def bake(head: Head, gaze: Gaze, progress: Progress = silent) -> BakedHead:
    """Bake a head at a gaze.

    Args:
        head: Sampled around its surface.
        gaze: Of the face; the eyes turn.
        progress: Told how many parts of the surface are done; what it raises ends the bake.

    Raises:
        UserError: the field cannot be baked: not sampled around a surface, merged after compositing, or
            its density is nearly everywhere.
    """
    started = time.perf_counter()
    config = head.field.config
    if head.sampler != "guided" or config.streams != "two" or config.merge != "joint":
        raise UserError("only fields of two streams, sampled around a surface and merged as one medium, can be baked")
    bound = head.at(gaze)
    with head.quickly():
        eyes = head.grids["eyes"].grown(1)
        band = head.surface_band(("face", "eyes"))
        if band is None:
            raise UserError("the density of this field is nearly everywhere; there is no surface to bake")
        found = []
        parts = band.points.split(max(1, head.chunk) * workers_for(head.device))
        for points in counted(parts, progress, "bake", len(parts)):
            found += head.in_chunks(bound.features, points, 4)
        density = DensityLattice(band, torch.cat([item[0] for item in found]), bound.surface_spread)
        features = FeatureLattice(band, torch.cat([item[1] for item in found]))
    report = BakeReport(time.perf_counter() - started, len(band.vertices), density.nbytes + features.nbytes, gaze)
    return BakedHead(head, Bake(density, features, eyes, report))


class BakedHead:
    """See `gazenerf.heads.interface.HeadField`; made by `bake`.

    Args:
        head: What was baked; it renders what is not.
        baked: The lattices.
        hasty: Interpolate eyes as well at the gaze of the bake, for small pictures that pass by: lids have a pale rim.

    Attributes:
        frames: Draws several views in one pass.
    """

    def __init__(self, head: Head, baked: Bake, hasty: bool = False) -> None:
        self.head, self.baked, self.subject, self.hasty = head, baked, head.subject, hasty
        self.frames = FrameBatches(head, draw_together)

    @property
    def report(self) -> BakeReport:
        """What the bake cost."""
        return self.baked.report

    @property
    def device(self) -> torch.device:
        """See `HeadField`."""
        return self.head.device

    @property
    def trained_range(self) -> GazeRange | None:
        """See `HeadField`."""
        return self.head.trained_range

    def at(self, gaze: Gaze) -> BakedBoundHead:
        """The same bake with the eyes turned; binds the gaze."""
        return BakedBoundHead(self.baked, self.head.at(gaze), self.hasty)

    def in_haste(self) -> BakedHead:
        """The same bake, `hasty`."""
        return BakedHead(self.head.with_what_is_at_hand(), self.baked, hasty=True)


class BakedBoundHead:
    """See `gazenerf.heads.interface.BoundField`; made by `BakedHead.at`.

    `render` of `head` is baked; other parts, densities and full-size geometry are the bound head's own.

    Args:
        baked: The lattices.
        bound: The head at a gaze.
        hasty: See `BakedHead`.

    Attributes:
        asks: Whether the network is queried about the eyes.
    """

    def __init__(self, baked: Bake, bound: BoundHead, hasty: bool = False) -> None:
        self.baked, self.bound = baked, bound
        self.asks = not hasty or bound.gaze != baked.report.gaze
        self.subject, self.gaze, self.box = bound.subject, bound.gaze, bound.box
        self.metres_per_unit, self.weights_hash = bound.metres_per_unit, bound.weights_hash
        self.surface_spread = bound.surface_spread
        self.image_size = bound.image_size

    @property
    def device(self) -> torch.device:
        """See `BoundField`."""
        return self.bound.device

    @property
    def parts(self) -> tuple[Part, ...]:
        """See `BoundField`."""
        return self.bound.parts

    @property
    def background(self) -> np.ndarray:
        """(3,) sRGB of an empty ray."""
        return self.bound.background

    def density(self, points: torch.Tensor, part: Part = "head") -> torch.Tensor:
        """See `BoundField`; not baked."""
        return self.bound.density(points, part)

    def render_geometry(self, camera: Camera, part: Part = "head", normals: bool = False) -> GeometryView:
        """See `BoundField`; not baked."""
        return self.bound.render_geometry(camera, part, normals)

    def render(self, camera: Camera, parts: tuple[Part, ...] = ("head",)) -> RenderedView:
        """See `BoundField`; only `head` is baked."""
        return self._render(camera, parts, self.bound.render)

    def render_cut_out(self, camera: Camera, parts: tuple[Part, ...] = ("head",)) -> RenderedView:
        """See `gazenerf.heads.cutouts.CutOutField`; only `head` is baked."""
        return self._render(camera, parts, self.bound.render_cut_out, cutouts=True)

    def _render(
        self,
        camera: Camera,
        parts: tuple[Part, ...],
        other: Callable[[Camera, tuple[Part, ...]], RenderedView],
        cutouts: bool = False,
    ) -> RenderedView:
        rest: tuple[Part, ...] = tuple(part for part in parts if part != "head")
        view = other(camera, rest) if rest else RenderedView(camera, {}, {})
        if "head" not in parts:
            return view
        [drawn] = self.bound.head.within_memory(partial(draw_together, [self], [camera], cutouts))
        return view.with_head(drawn.image, drawn.geometry, parts, drawn.cutout)


def draw_together(bounds: Sequence[BakedBoundHead], cameras: Sequence[Camera], cutouts: bool = False) -> list[Drawn]:
    """Pictures of one baked head and their geometry, computed in one pass.

    Args:
        bounds: One for each picture, all of one bake; the same where gazes are the same.
        cameras: One for each picture, all of one size.
        cutouts: Also give the pictures without what is behind them.
    """
    drawn = draw_rays([one.bound for one in bounds], _BakedRays(bounds), cameras, cutouts)
    assert drawn is not None
    return drawn


class _BakedRays(PictureRays):
    """Rays that look into a bake, and query the network only about the eyes.

    Args:
        bounds: One for each picture, all of one bake.
    """

    def __init__(self, bounds: Sequence[BakedBoundHead]) -> None:
        self.bounds, self.baked = bounds, bounds[0].baked
        self.config = bounds[0].bound.field.config

    def first(self, rays: Rays, window: Window | None) -> RayFeatures:
        """See `PictureRays`; a bake is looked through from the front, whatever the window."""
        return self._surface(rays)

    def behind(self, rays: Rays, window: Window) -> RayFeatures:
        """See `PictureRays`."""
        return self._surface(rays, window[0])

    def _surface(self, seen: Rays, start: torch.Tensor | None = None) -> RayFeatures:
        """What rays see of the first surface from a distance `start` (R,) on."""
        rays_o, rays_d, background, pictures = seen
        config, density = self.config, self.baked.density
        features, opacity = background.clone(), rays_o.new_zeros(len(rays_o))
        distance = rays_o.new_full((len(rays_o),), torch.nan)
        surface, hit = density.first_surface(rays_o, rays_d, start)
        if asking := [(i, one.bound) for i, one in enumerate(self.bounds) if one.asks]:
            near = self.baked.eyes.at(rays_o + surface.nan_to_num()[:, None] * rays_d) & hit
            for i, bound in asking:
                here = near if len(self.bounds) == 1 else near & (pictures == i)
                live, hit = here.nonzero()[:, 0], hit & ~here
                features[live], opacity[live], distance[live] = composite_near(
                    bound, rays_o[live], rays_d[live], surface[live], background[live]
                )[:3]
        rays = hit.nonzero()[:, 0]
        t, deltas = shell_samples(surface[rays], config.shell, config.shell_samples)
        points = rays_o[rays, None] + t[..., None] * rays_d[rays, None]
        weights, alpha = composite(density.density(points), deltas)
        heavy = weights > FAINT
        row = self.baked.features.blend(points[heavy], weights[heavy], heavy.sum(1), alpha)
        features[rays] = row + (1.0 - alpha[:, None]) * background[rays]
        opacity[rays] = alpha
        expected = (weights * t).sum(-1) / alpha.clamp(min=1e-6)
        distance[rays] = torch.where(alpha >= OPACITY_FLOOR, expected, torch.nan)
        return RayFeatures(features, opacity, distance, torch.where(hit, surface + config.shell, torch.nan))
