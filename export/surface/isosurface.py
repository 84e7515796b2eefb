"""Triangle meshes of density levels."""

from __future__ import annotations

import numpy as np
import trimesh

from gazenerf.errors import UserError
from gazenerf.export.mesh.triangles import signed_volumes, without_collapsed
from gazenerf.export.surface.densities import DensityGrid, extent, meant_distances

METHODS = ("flying-edges", "lewiner")


def isosurface(
    grid: DensityGrid, level: float, method: str = "flying-edges", spread: float | None = None
) -> trimesh.Trimesh:
    """The surface where density equals a level, in world units, closed at the border of the box.

    Args:
        grid: The density.
        level: Per world unit.
        method: `flying-edges` (VTK, through pyvista) or `lewiner` (scikit-image).
        spread: `BoundField.surface_spread`: with it the surface is interpolated between the distances that the
            densities mean, which are straight across a cell where densities are steps.

    Raises:
        UserError: unknown method, or the level leaves no surface; the message says which do.
    """
    if method not in METHODS:
        raise UserError(f"unknown isosurface method {method!r}; there are {', '.join(METHODS)}")
    values = grid.values
    if not (np.isfinite(level) and level > 0):
        raise UserError(f"a density threshold must be a positive number, got {level}")
    if not (values > level).any():
        positive = values[values > 0]
        known = "the volume is empty"
        if positive.size:
            low, middle, high = np.percentile(positive, [5, 50, 95])
            known = f"5/50/95 % of its positive densities lie below {low:.3g}/{middle:.3g}/{high:.3g}"
        raise UserError(
            f"no surface at density {level:g}: the largest is {values.max():.3g} and {known}; lower --threshold"
        )
    low, values = _around(values, level)
    if spread is not None:
        found = meant_distances(values, spread), meant_distances(np.array([level], np.float32), spread)
        values, level = -found[0], -float(found[1][0])
    origin = grid.origin + grid.spacing * low
    if method == "flying-edges":
        places, faces = _flying_edges(values, level)
    else:
        from skimage.measure import marching_cubes

        places, faces, _, _ = marching_cubes(values, level, gradient_direction="ascent")
    vertices = origin + grid.spacing * places.astype(np.float64)
    mesh = without_collapsed(trimesh.Trimesh(vertices, faces, process=False))
    if signed_volumes(mesh).sum() < 0:
        mesh.invert()
    return mesh


def _around(values: np.ndarray, level: float) -> tuple[np.ndarray, np.ndarray]:
    """What exceeds a level and one point more on every side, 0 beyond the border; index of its first point."""
    low, high = extent(values > level)
    inner = values[tuple(slice(max(a - 1, 0), b + 1) for a, b in zip(low, high, strict=True))]
    beyond = [(int(a == 0), int(b == n)) for a, b, n in zip(low, high, values.shape, strict=True)]
    return low - 1, np.ascontiguousarray(np.pad(inner, beyond) if np.any(beyond) else inner)


def _flying_edges(values: np.ndarray, level: float) -> tuple[np.ndarray, np.ndarray]:
    """Vertices in steps from the first point, and faces."""
    import pyvista as pv

    image = pv.ImageData(dimensions=values.shape[::-1])
    image.point_data["density"] = values.ravel()  # x fastest for VTK: z here, and no copy
    surface = image.contour([level], scalars="density", method="flying_edges", compute_normals=False)
    faces = np.asarray(surface.faces).reshape(-1, 4)[:, :0:-1]
    return np.asarray(surface.points)[:, ::-1], faces.copy()
