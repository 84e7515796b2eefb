"""The surface of a part where its density passes a threshold."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import trimesh

from gazenerf.errors import UserError
from gazenerf.export.mesh.cleaning import keep_largest
from gazenerf.export.mesh.sphere_fit import Eyeball, fit_eyeballs
from gazenerf.export.surface.coverage import RenderedDepth
from gazenerf.export.surface.densities import DensityGrid, extent, fill_enclosed, sample_density
from gazenerf.export.surface.isosurface import isosurface
from gazenerf.export.surface.lids import closed_lids
from gazenerf.export.surface.refine import refine_density, refine_grid
from gazenerf.export.surface.threshold import CANDIDATES, Threshold, choose_threshold
from gazenerf.heads.interface import BoundField, Part
from gazenerf.progress import Progress, silent, steps_of

JUDGING_RESOLUTION = 96
"""Grid points along the longest side while a threshold is chosen."""

PROBE = 64
"""Grid points along the longest side while the eyes are looked for."""

KEPT_COMPONENTS = {"face": 1, "eyes": 2, "head": 3}


@dataclass(frozen=True)
class Surface:
    """A surface as it was found, before it is cleaned.

    Attributes:
        mesh: World units.
        grid: Points along each axis.
        spacing: World units.
        queries: Points at which the field's density was queried.
        steps: How it was found.
        threshold: The level and why, None where no level was chosen.
        volume: The density, queried at every point; None where it was not kept.
    """

    mesh: trimesh.Trimesh
    grid: tuple[int, ...]
    spacing: float
    queries: int
    steps: tuple[str, ...]
    threshold: Threshold | None = None
    volume: DensityGrid | None = None


def density_surface(
    bound: BoundField,
    part: Part,
    *,
    resolution: int,
    threshold: str | float,
    method: str,
    dense: bool = False,
    rendered: Callable[[], RenderedDepth] | None = None,
    progress: Progress = silent,
) -> Surface:
    """The isosurface of one part.

    The threshold is chosen on a grid of at most `JUDGING_RESOLUTION`, the density sampled along that
    level's surface, and what is enclosed made solid (face and head). Where densities follow from signed distances,
    `auto` is the distance 0, and nothing has to be chosen.

    Args:
        resolution: Grid points along the longest side of the part's box.
        threshold: `auto`, a density, or a percentile such as `p50`.
        method: One of `gazenerf.export.surface.isosurface.METHODS`.
        dense: Query every point of the grid and return it as the surface's `volume`.
        rendered: Gives the depth that `auto` goes by; rendered here where None.
        progress: Told about stages.

    Raises:
        UserError: impossible resolution, an empty volume, or no surface at the threshold.
    """
    box, queries = part_box(bound, part)
    sockets, more = _sockets(bound, box) if part == "face" else (None, 0)
    queries += more

    def volumes(side: int, levels: tuple[float, float], dense: bool) -> tuple[DensityGrid, DensityGrid | None]:
        told = steps_of(progress, f"{part} density")
        own = (
            sample_density(bound, part, box, side, told)
            if dense
            else refine_density(bound, part, box, side, levels, progress=told)
        )
        return own, None if sockets is None else _within(bound, own, sockets, levels)

    spread = bound.surface_spread
    level = _fixed_level(threshold)
    if level is not None:
        chosen = Threshold(level, "fixed")
    elif threshold == "auto" and spread is not None:
        chosen = Threshold(0.5 / spread, "distance")
    else:
        judged, beside = volumes(min(resolution, JUDGING_RESOLUTION), _judged_levels(threshold), dense=False)
        queries += judged.queries + (beside.queries if beside else 0)

        def candidate(level: float) -> trimesh.Trimesh:
            solid = judged if part == "eyes" else fill_enclosed(judged, beside, level)
            return keep_largest(isosurface(solid, level, method, spread), KEPT_COMPONENTS[part])

        chosen = choose_threshold(
            part, judged, threshold, candidate, rendered or (lambda: RenderedDepth.of(bound, part))
        )
    grid, other = volumes(resolution, (chosen.level, chosen.level), dense)
    shape, spacing, volume = grid.values.shape, grid.spacing, grid if dense else None
    steps = ["every grid point's density" if dense else "coarse-to-fine density"]
    if spread is not None and other is not None and (eyes := _eyeballs(other, chosen.level, method, spread)):
        grid = closed_lids(bound, grid, eyes, spread)
        steps.append("lids closed onto the eyeballs")
    queries += grid.queries + (other.queries if other else 0)
    solid = grid if part == "eyes" else fill_enclosed(grid, other, chosen.level)
    steps += [*(() if part == "eyes" else ("enclosed space filled",)), method.replace("-", " ")]
    del grid, other
    mesh = isosurface(solid, chosen.level, method, spread)
    return Surface(mesh, shape, spacing, queries, tuple(steps), chosen, volume)


def _eyeballs(eyes: DensityGrid, level: float, method: str, spread: float) -> tuple[Eyeball, ...]:
    """Spheres fitted to the eyes' surfaces; none where they are not round."""
    try:
        surface = keep_largest(isosurface(eyes, level, method, spread), KEPT_COMPONENTS["eyes"])
        return fit_eyeballs(surface)
    except UserError:
        return ()


def _sockets(bound: BoundField, box: np.ndarray) -> tuple[np.ndarray | None, int]:
    """The part of a box (2, 3) where the eyes are, None where there are none; how many points that took."""
    if "eyes" not in bound.parts:
        return None, 0
    try:
        eyes, queries = part_box(bound, "eyes")
    except EmptyEyes as empty:
        return None, empty.queries
    return np.stack([np.maximum(eyes[0], box[0]), np.minimum(eyes[1], box[1])]), queries


def _within(bound: BoundField, face: DensityGrid, box: np.ndarray, levels: tuple[float, float]) -> DensityGrid:
    """The eyes' density at the points of the face's grid that lie in a box (2, 3) and one more on each side."""
    ends = (box - face.origin) / face.spacing
    first = np.maximum(np.floor(ends[0]).astype(int), 0)
    last = np.minimum(np.ceil(ends[1]).astype(int), np.array(face.values.shape) - 1)
    nx, ny, nz = (int(n) for n in last - first + 1)
    return refine_grid(bound, "eyes", face.origin + face.spacing * first, (nx, ny, nz), face.spacing, levels)


def _fixed_level(threshold: str | float) -> float | None:
    """A threshold that needs no judging."""
    try:
        return float(threshold)
    except ValueError:
        return None


def _judged_levels(threshold: str | float) -> tuple[float, float]:
    return (CANDIDATES[0], CANDIDATES[-1]) if threshold == "auto" else (1e-3, np.inf)


class EmptyEyes(UserError):
    """The eyes volume is empty.

    Attributes:
        queries: How many points it took to find out.
    """

    def __init__(self, queries: int) -> None:
        super().__init__("the eyes volume is empty; train longer or export --parts face")
        self.queries = queries


def part_box(bound: BoundField, part: Part) -> tuple[np.ndarray, int]:
    """The field's box; for the eyes the smallest box around their density, so that it is sampled finely.

    Also how many points that took.

    Raises:
        EmptyEyes: there are no eyes.
    """
    if part != "eyes":
        return bound.box, 0
    probe = refine_density(bound, "eyes", bound.box, PROBE, (0.5, np.inf))
    low, high = extent(probe.values > 0.5)
    if not high.any():
        raise EmptyEyes(probe.queries)
    corners = probe.origin + probe.spacing * np.stack([low - 2, high + 1])
    return corners, probe.queries
