"""Which density is the surface: a number, a percentile, or the level whose surface is nearest to the rendered depth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import trimesh

from gazenerf.errors import UserError
from gazenerf.export.mesh.rays import cast_rays
from gazenerf.export.surface.densities import DensityGrid
from gazenerf.geometry import Camera
from gazenerf.heads.interface import BoundField, Part

VIEWS = ((0.0, 0.0), (40.0, 5.0), (-40.0, -5.0))
"""Yaw and pitch, degrees, of the views that judge a threshold."""

SIDES = ((85.0, 0.0), (-85.0, 0.0))
"""Views added where ears are: of any part but the eyes, whose sides no picture shows."""

NEAR_MM = 2.0
"""Rendered depth without a surface this near counts as missing from a mesh."""

CAP_MM = 10.0
"""Distances count up to this, and a ray without a surface counts this much, so that an ear is not lost for a better
median."""

CANDIDATES = (3.0, 6.0, 12.0, 24.0, 48.0, 96.0)
"""Densities per world unit that `auto` tries where the volume reaches them; then two beside the best."""

EMPTY = 1.0
"""Largest density, per world unit, of a volume that shows nothing: a tenth of a unit of it is 10 % opaque."""


@dataclass(frozen=True)
class Judged:
    """A level held against the depth that the field renders.

    Attributes:
        level: Density per world unit.
        depth_error_mm: Median distance between surface and rendered expected depth along the rays that hit
            both, millimetres; inf where none does.
        missing: Share of the rendered depth that has no surface within `NEAR_MM`.
        capped_mm: Mean distance over all rays that show depth, each at most `CAP_MM`; what the choice goes by.
    """

    level: float
    depth_error_mm: float
    missing: float
    capped_mm: float


@dataclass(frozen=True)
class Threshold:
    """A chosen level.

    Attributes:
        level: Density per world unit.
        how: `auto`, `fixed` or `percentile`.
        depth_error_mm: Median distance between surface and rendered expected depth, millimetres;
            NaN when it was not measured.
        missing: Share of the rendered depth without a surface within `NEAR_MM`; NaN when it was not measured.
        tried: Every candidate.
    """

    level: float
    how: str
    depth_error_mm: float = float("nan")
    missing: float = float("nan")
    tried: tuple[Judged, ...] = ()


def depth_views(bound: BoundField, part: Part, size: int = 96) -> list[tuple[Camera, np.ndarray]]:
    """Cameras and the field's expected depth (H, W) in them, for `depth_disagreement`."""
    views = VIEWS if part == "eyes" else VIEWS + SIDES
    cameras = [Camera.orbit(float(np.deg2rad(yaw)), float(np.deg2rad(pitch)), size=size) for yaw, pitch in views]
    return [(camera, bound.render_geometry(camera, part).depth) for camera in cameras]


def judge(
    level: float, mesh: trimesh.Trimesh, views: list[tuple[Camera, np.ndarray]], metres_per_unit: float
) -> Judged:
    """A mesh of a level against the depth (H, W) that cameras see, both ways: how far off, and how much is missing."""
    errors = []
    for camera, depth in views:
        rays_o, rays_d = camera.rays()
        seen = np.isfinite(depth)
        hit = cast_rays(mesh, rays_o[seen], rays_d[seen])
        errors.append(np.abs(hit - depth[seen]))
    error = 1000.0 * metres_per_unit * np.concatenate(errors)
    if not error.size:
        return Judged(level, float("inf"), 1.0, CAP_MM)
    missing = float(np.mean(~(error <= NEAR_MM)))
    capped = float(np.minimum(np.nan_to_num(error, nan=CAP_MM), CAP_MM).mean())
    known = error[np.isfinite(error)]
    return Judged(level, float(np.median(known)) if known.size else float("inf"), missing, capped)


def choose_threshold(
    bound: BoundField, part: Part, grid: DensityGrid, asked: str | float, surface: Callable[[float], trimesh.Trimesh]
) -> Threshold:
    """Resolve what was asked for.

    Args:
        asked: `auto`, a density, or a percentile of the positive densities such as `p50`.
        surface: Level to mesh in world units.

    Raises:
        UserError: not a threshold, or no candidate gives a surface.
    """
    if isinstance(asked, str) and asked != "auto":
        try:
            if asked.startswith("p"):
                share = float(asked[1:])
                if not 0 < share < 100:
                    raise ValueError
                positive = grid.values[grid.values > 0]
                if not positive.size:
                    raise UserError("the volume is empty; no percentile of its density exists")
                return Threshold(float(np.percentile(positive, share)), "percentile")
            asked = float(asked)
        except ValueError as error:
            raise UserError(f"--threshold {asked}: give auto, a density, or a percentile such as p50") from error
    if not isinstance(asked, str):
        return Threshold(float(asked), "fixed")
    largest = float(grid.values.max())
    if largest < EMPTY:
        raise UserError(
            f"the {part} volume is empty (its largest density is {largest:.3g} per unit): "
            "the field is untrained, or its box misses the head"
        )
    views = depth_views(bound, part)
    tried = []
    for level in CANDIDATES:
        if level < 0.6 * largest:
            tried.append(judge(level, surface(level), views, bound.metres_per_unit))
    if not tried or not np.isfinite(min(found.depth_error_mm for found in tried)):
        raise UserError(
            f"no automatic threshold fits the {part} volume, whose largest density is {largest:.3g}; give --threshold X"
        )
    levels = [found.level for found in tried]
    best = min(tried, key=lambda found: found.capped_mm).level
    place = levels.index(best)
    for other in levels[max(place - 1, 0) : place] + levels[place + 1 : place + 2]:
        between = float(np.sqrt(best * other))
        tried.append(judge(between, surface(between), views, bound.metres_per_unit))
    chosen = min(tried, key=lambda found: found.capped_mm)
    ordered = tuple(sorted(tried, key=lambda found: found.level))
    return Threshold(chosen.level, "auto", chosen.depth_error_mm, chosen.missing, ordered)
