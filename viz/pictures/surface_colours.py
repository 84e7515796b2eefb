"""Signed differences as colours, and surfaces coloured by their distance from another one."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from gazenerf.export.appearance.colours import with_vertex_colours
from gazenerf.export.mesh.triangles import to_pyvista

if TYPE_CHECKING:
    import trimesh

NOTHING = np.array([38, 38, 42], np.uint8)
NEARER, FARTHER = np.array([33, 102, 172], np.uint8), np.array([178, 24, 43], np.uint8)

GIVE_UP_MM = 15.0
"""Vertices farther than this from the other surface are not compared and are grey."""

LIMIT_MM = 3.0
"""Distances beyond this take the end colours."""

GREY = np.array([120, 120, 124], np.uint8)


def signed_colours(values: np.ndarray, limit: float) -> np.ndarray:
    """(H, W) signed values to (H, W, 3) uint8: blue nearer, white equal, red farther, dark where NaN."""
    share = np.clip(np.nan_to_num(values) / limit, -1.0, 1.0)[..., None]
    white = np.full(3, 247.0)
    end = np.where(share > 0, FARTHER, NEARER).astype(np.float64)
    out = np.round(white + (end - white) * np.abs(share)).astype(np.uint8)
    out[~np.isfinite(values)] = NOTHING
    return out


def colour_bar(width: int = 256, height: int = 12) -> np.ndarray:
    """(height, width, 3) uint8 the colours from minus to plus the limit."""
    return signed_colours(np.linspace(-1.0, 1.0, width)[None].repeat(height, axis=0), 1.0)


def signed_distance(points: np.ndarray, surface: trimesh.Trimesh) -> np.ndarray:
    """(N,) distance of points (N, 3) from a surface, positive on the side its normals point to.

    The surface may be open: the sign is that of the nearest point's pseudonormal (Baerentzen and Aanaes 2005), where a
    facet's normal would be wrong at edges.
    """
    import pyvista as pv

    cloud = pv.PolyData(np.ascontiguousarray(points, dtype=np.float64))
    found = cloud.compute_implicit_distance(to_pyvista(surface))
    return np.asarray(found["implicit_distance"])


def outward_mm(points: np.ndarray, surface: trimesh.Trimesh, metres_per_unit: float) -> np.ndarray:
    """(N,) signed distance of points (N, 3) from a surface, both in world units, in millimetres.

    Positive on the side its normals point to; NaN beyond `GIVE_UP_MM`.
    """
    mm = 1000.0 * metres_per_unit * signed_distance(points, surface)
    return np.where(np.abs(mm) > GIVE_UP_MM, np.nan, mm)


def coloured_by_distance(mesh: trimesh.Trimesh, outward: np.ndarray) -> trimesh.Trimesh:
    """The mesh with colours for its vertices' distances (V,) outward, millimetres, NaN where unknown.

    White where there is none, blue for `LIMIT_MM` outward, red for as much inward, grey where unknown.
    """
    colours = signed_colours(-outward, LIMIT_MM)
    colours[~np.isfinite(outward)] = GREY
    return with_vertex_colours(mesh, colours)
