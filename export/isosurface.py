"""Triangle meshes of density levels."""

from __future__ import annotations

import numpy as np
import trimesh

from export.cleaning import without_collapsed
from export.densities import DensityGrid
from gazenerf.errors import UserError

METHODS = ("flying-edges", "lewiner")


def isosurface(grid: DensityGrid, level: float, method: str = "flying-edges") -> trimesh.Trimesh:
    """The surface where density equals a level, in world units, closed at the border of the box.

    Args:
        grid: The density.
        level: Per world unit.
        method: `flying-edges` (VTK, through pyvista) or `lewiner` (scikit-image).

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
    padded = np.pad(values, 1)
    origin = grid.origin - grid.spacing
    if method == "flying-edges":
        vertices, faces = _flying_edges(padded, origin, grid.spacing, level)
    else:
        from skimage.measure import marching_cubes

        vertices, faces, _, _ = marching_cubes(padded, level, spacing=(grid.spacing,) * 3, gradient_direction="ascent")
        vertices = vertices + origin
    mesh = without_collapsed(trimesh.Trimesh(vertices, faces, process=False))
    if mesh.volume < 0:
        mesh.invert()
    return mesh


def _flying_edges(
    values: np.ndarray, origin: np.ndarray, spacing: float, level: float
) -> tuple[np.ndarray, np.ndarray]:
    import pyvista as pv

    image = pv.ImageData(dimensions=values.shape, spacing=(spacing,) * 3, origin=tuple(origin))
    image.point_data["density"] = values.ravel(order="F")
    surface = image.contour([level], scalars="density", method="flying_edges", compute_normals=False)
    faces = np.asarray(surface.faces).reshape(-1, 4)[:, 1:]
    return np.asarray(surface.points, dtype=np.float64), faces.copy()
