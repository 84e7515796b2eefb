"""Which density is the surface: a number, a percentile, or the level whose surface fits the rendered depth best."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import trimesh

from gazenerf.errors import UserError
from gazenerf.export.surface.coverage import Coverage, RenderedDepth, coverage
from gazenerf.export.surface.densities import DensityGrid
from gazenerf.heads.interface import Part

CANDIDATES = (3.0, 6.0, 12.0, 24.0, 48.0, 96.0)
"""Densities per world unit that `auto` tries where the volume reaches them; then the best times `STEPS`."""

STEPS = tuple(2.0 ** (k / 8.0) for k in range(-4, 5) if k)
"""Factors of the levels around the best candidate."""

ALIKE = 0.15
"""Levels whose costs are this much larger than the least, as a share, are taken as good as the best of them."""

EMPTY = 1.0
"""Largest density, per world unit, of a volume that shows nothing: a tenth of a unit of it is 10 % opaque."""


@dataclass(frozen=True)
class Judged:
    """A level and its surface held against the depth that the field renders.

    Attributes:
        level: Density per world unit.
        coverage: Of the level's surface.
    """

    level: float
    coverage: Coverage


@dataclass(frozen=True)
class Threshold:
    """A chosen level.

    Attributes:
        level: Density per world unit.
        how: `auto`, `fixed`, `percentile`, or `distance` where it is that of signed distances.
        tried: Every candidate, as the choice saw them: on a grid coarser than the mesh's, before it is cleaned.
    """

    level: float
    how: str
    tried: tuple[Judged, ...] = ()


def least_lost(tried: Sequence[Judged]) -> Judged:
    """Of the levels that cost about as little as the best, the one whose surface loses the smallest parts.

    The costs are flat around the best level, over a range in which thin parts come and go: ears above all.
    """
    least = min(found.coverage.cost_mm for found in tried)
    alike = [found for found in tried if found.coverage.cost_mm <= (1.0 + ALIKE) * least]
    return min(alike, key=lambda found: (found.coverage.lost_cm2, found.coverage.cost_mm))


def choose_threshold(
    part: Part,
    grid: DensityGrid,
    asked: str | float,
    surface: Callable[[float], trimesh.Trimesh],
    rendered: Callable[[], RenderedDepth],
) -> Threshold:
    """Resolve what was asked for.

    Args:
        asked: `auto`, a density, or a percentile of the positive densities such as `p50`.
        surface: Level to mesh in world units.
        rendered: Gives the depth that the field renders of the part; asked by `auto` only.

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
    depth, tried = rendered(), []
    for level in CANDIDATES:
        if level < 0.6 * largest:
            tried.append(Judged(level, coverage(surface(level), depth)))
    if not any(np.isfinite(found.coverage.depth_error_mm) for found in tried):
        raise UserError(
            f"no automatic threshold fits the {part} volume, whose largest density is {largest:.3g}; give --threshold X"
        )
    best = min(tried, key=lambda found: found.coverage.cost_mm).level
    beside = [best * step for step in STEPS if CANDIDATES[0] <= best * step <= min(CANDIDATES[-1], 0.6 * largest)]
    tried += [Judged(level, coverage(surface(level), depth)) for level in beside]
    chosen = least_lost(tried)
    return Threshold(chosen.level, "auto", tuple(sorted(tried, key=lambda found: found.level)))
