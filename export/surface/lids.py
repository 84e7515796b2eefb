"""Lids closed onto the eyeballs, where a surface is known by distances.

The lids of a field are sheets that end in an edge and stand a little off the eyeballs. Such an edge is thinner than the
cells of a grid, so that an isosurface of the face alone breaks off along it. Here what lies between a lid and its
eyeball belongs to the face, and so does the eyeball itself, a little smaller: lids end in walls that go down to it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from scipy import ndimage

from gazenerf.export.mesh.sphere_fit import Eyeball
from gazenerf.export.surface.densities import DensityGrid, meant_distances, query, sample_density
from gazenerf.field.distance import laplace_density
from gazenerf.heads.interface import BoundField, Part

REACH_MM = 5.0
"""How far above the eyeball a lid lies, at most."""

BEYOND_MM = 3.0
"""How much farther its outer surface is looked for."""

RECESS_MM, RECESS_CELLS = 0.8, 0.4
"""How far behind the eyeball's surface the face goes on: the larger of millimetres and cells of the grid."""

STEP_MM = 0.25
"""Between two places at which lids are looked for."""

BEHIND_MM = 1.0
"""How far below a point the same lid is looked for, to tell how thick it is."""

FRONT = 0.15
"""Least cosine between the way out of an eyeball and the head's forward axis: lids lie there."""

STEEP = 4.0
"""A sheet that ends in an edge is at most half its thickness deep in the middle; depths count so many times, that they
are more like distances from the edge."""

GRID_MM = 1.2
"""Cells of the grids from which `ClosedFace` is read; what it shows is thicker than they are."""

FAINT_MM, SOUND_MM = 0.15, 0.5
"""A learned distance passes a lid that is thinner than it can follow without becoming negative: up to so little above 0
counts as the lid, and less where the lid is deeper, nothing where it is as deep as the second number."""

FLATTEST = 0.2
"""Cosine between a way and a lid's normal down to which a way's length tells of the depth below the lid."""


def closed_lids(bound: BoundField, face: DensityGrid, eyes: Sequence[Eyeball], spread: float) -> DensityGrid:
    """The density of a face whose lids reach down to the eyeballs.

    At every grid point before an eyeball the face is looked for along the way out from the eyeball's centre. Where it
    is met within `REACH_MM` of the eyeball, the point is as deep in the face as its outermost surface is away; where it
    is not, the point is as far outside as the way comes near to it. Both change smoothly from point to point, and with
    them the place where the lid ends. Eyeballs count as parts of the face from `RECESS_MM` below their surface.

    Args:
        bound: What the grid is of; the face is queried anew at points along the ways.
        face: Its density, exact near the surface.
        eyes: Left and right, world units.
        spread: `BoundField.surface_spread`.
    """
    unit = 1.0 / (1000.0 * bound.metres_per_unit)
    recess = max(RECESS_MM * unit, RECESS_CELLS * face.spacing)
    values, queries = face.values.copy(), face.queries
    for eye in eyes:
        outer = eye.radius + REACH_MM * unit
        index, points = _points_around(face, eye.centre, outer)
        away = points - eye.centre
        height = np.linalg.norm(away, axis=1)
        outwards = away / np.maximum(height, 1e-9)[:, None]
        asked = (height > eye.radius - recess - 2.0 * face.spacing) & (height < outer) & (outwards[:, 2] > FRONT)
        below, more = _below_lids(bound, points[asked], outwards[asked], outer - height[asked], spread, unit)
        joined = height - (eye.radius - recess)
        joined[joined > face.spacing] = np.inf
        joined[asked] = np.minimum(joined[asked], below)
        here = tuple(index.T)
        deeper = laplace_density(torch.from_numpy(joined.astype(np.float32)), spread).numpy()
        values[here] = np.where(asked, deeper, np.maximum(values[here], deeper))
        queries += more
    return DensityGrid(values, face.origin, face.spacing, queries)


class ClosedFace:
    """A bound field's face with its lids closed, at any point; what follows the lids of another gaze asks this.

    About the eyes it is read off grids of `GRID_MM`, elsewhere it is the field's own.

    Args:
        bound: Whose densities follow from signed distances.
        eyes: Left and right, world units.
    """

    def __init__(self, bound: BoundField, eyes: Sequence[Eyeball]) -> None:
        assert bound.surface_spread is not None
        self._bound, self._spread = bound, bound.surface_spread
        self.metres_per_unit, self.device = bound.metres_per_unit, bound.device
        self._grids = [self._about(eye) for eye in eyes]

    def _about(self, eye: Eyeball) -> tuple[DensityGrid, np.ndarray]:
        """The grid about an eye and the distances that its densities mean."""
        unit = 1.0 / (1000.0 * self.metres_per_unit)
        spacing, reach = GRID_MM * unit, eye.radius + (REACH_MM + GRID_MM) * unit
        side = int(np.ceil(2.0 * reach / spacing)) + 1
        corner = np.asarray(eye.centre, np.float64) - reach
        face = sample_density(self._bound, "face", np.stack([corner, corner + spacing * (side - 1)]), side)
        closed = closed_lids(self._bound, face, [eye], self._spread)
        return closed, meant_distances(closed.values, self._spread)

    def density(self, points: torch.Tensor, part: Part = "face") -> torch.Tensor:
        """Of the face at points (N, 3), per world unit (N,)."""
        assert part == "face"
        places = points.double().numpy()
        distance, known = np.zeros(len(places), np.float32), np.zeros(len(places), bool)
        for grid, distances in self._grids:
            at = (places - grid.origin) / grid.spacing
            inside = ((at >= 0.0) & (at <= np.array(distances.shape) - 1)).all(axis=1)
            distance[inside] = ndimage.map_coordinates(distances, at[inside].T, order=1)
            known |= inside
        density = laplace_density(torch.from_numpy(distance), self._spread)
        if not known.all():
            density[torch.from_numpy(~known)] = torch.from_numpy(query(self._bound, places[~known], "face"))
        return density


def _points_around(grid: DensityGrid, centre: np.ndarray, reach: float) -> tuple[np.ndarray, np.ndarray]:
    """Indices (N, 3) and places (N, 3) of the grid's points in a box around a centre (3,)."""
    low = np.floor((centre - reach - grid.origin) / grid.spacing).astype(int)
    high = np.ceil((centre + reach - grid.origin) / grid.spacing).astype(int) + 1
    low, high = np.maximum(low, 0), np.minimum(high, grid.values.shape)
    sides = [np.arange(a, b) for a, b in zip(low, high, strict=True)]
    index = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 3)
    return index, grid.origin + grid.spacing * index


def _below_lids(
    bound: BoundField, points: np.ndarray, outwards: np.ndarray, room: np.ndarray, spread: float, unit: float
) -> tuple[np.ndarray, int]:
    """Distances (N,) of points from the face with all that lies below it; how many points were queried.

    Args:
        bound: What is queried.
        points, outwards: (N, 3) world units, and directions in which a lid may lie.
        room: (N,) how far away it may lie.
        spread: As above.
        unit: World units in a millimetre.
    """
    step = STEP_MM * unit
    behind = int(BEHIND_MM / STEP_MM)
    ways = step * np.arange(-behind, int(np.ceil((room.max(initial=0.0) + BEYOND_MM * unit) / step)) + 1)
    found, queries = np.full((len(points), len(ways)), np.inf, dtype=np.float32), 0
    for i, way in enumerate(ways):
        asked = way <= room + BEYOND_MM * unit
        density = query(bound, points[asked] + way * outwards[asked], "face")
        found[asked, i] = meant_distances(density, spread)
        queries += int(asked.sum())
    deepest = np.where(ways <= room[:, None], found, np.inf).min(axis=1, initial=np.inf)
    found = (found - (FAINT_MM * unit * np.clip(1.0 + deepest / (SOUND_MM * unit), 0.0, 1.0))[:, None])[:, behind:]
    ways = ways[behind:]
    nearest = np.where(ways <= room[:, None], found, np.inf).min(axis=1, initial=np.inf)
    leaves = (found[:, :-1] <= 0.0) & (found[:, 1:] > 0.0) & np.isfinite(found[:, 1:])
    row, last = np.arange(len(points)), leaves.shape[1] - 1 - leaves[:, ::-1].argmax(axis=1)
    met = leaves.any(axis=1)
    inner, outer = np.where(met, found[row, last], 0.0), np.where(met, found[row, last + 1], step)
    rise = outer - inner
    depth = (step * last - step * inner / rise) * np.clip(rise / step, FLATTEST, 1.0)
    inside = np.where(met, np.maximum(STEEP * nearest, -depth), nearest)
    return np.where(nearest > 0.0, nearest, inside), queries
