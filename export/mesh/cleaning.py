"""Making a surface fit for use: pieces, smoothing, holes, fewer faces. Each step is optional and has a name."""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import trimesh

from gazenerf.errors import UserError
from gazenerf.export.mesh.rays import cast_rays
from gazenerf.export.mesh.repair import close_holes, repair
from gazenerf.export.mesh.triangles import (
    from_pyvista,
    pieces,
    signed_volumes,
    to_pyvista,
    with_faces,
    without_collapsed,
)

VOLUME_SHARE = 0.01
"""Change of the enclosed volume that decimation may cause where another way causes less."""


LOOKOUTS = 500
"""Faces of a component from which one looks out."""

DIRECTIONS = np.array([d for d in itertools.product((-1.0, 0.0, 1.0), repeat=3) if any(d)])
"""(26, 3) where to."""


@dataclass(frozen=True)
class Cleaning:
    """What to do to a surface, in this order.

    Attributes:
        repair: Make it manifold: repeated faces dropped, sheets that touch along an edge taken apart.
        seen: Drop connected pieces that cannot be seen from outside.
        components: Connected pieces to keep, those that enclose most; 0 keeps all.
        holes: Close holes up to this radius, world units; 0 for none.
        smoothing: Rounds of Taubin smoothing, which keeps the volume; 0 for none.
        max_faces: Quadric decimation to at most this many faces; None for no limit.
    """

    components: int = 0
    smoothing: int = 0
    max_faces: int | None = None
    holes: float = 0.0
    seen: bool = False
    repair: bool = False

    def __post_init__(self) -> None:
        if not self.holes >= 0.0:
            raise UserError(f"the radius of holes to close must be 0 or more, got {self.holes}")
        if not 0 <= self.smoothing <= 200:
            raise UserError(f"--smooth goes from 0 to 200 rounds, got {self.smoothing}")
        if self.max_faces is not None and self.max_faces < 100:
            raise UserError(f"--max-faces must be at least 100, got {self.max_faces}")

    def steps(self) -> tuple[str, ...]:
        """The names of the steps, for sidecars."""
        named = []
        if self.repair:
            named.append("repaired to manifold")
        if self.seen:
            named.append("pieces unseen from outside dropped")
        if self.components:
            named.append(f"largest {self.components} component(s) kept")
        if self.holes:
            named.append(f"holes up to {self.holes:.3g} units in radius closed")
        if self.smoothing:
            named.append(f"Taubin smoothing, {self.smoothing} rounds")
        if self.max_faces:
            named.append(f"quadric decimation to at most {self.max_faces} faces")
        return tuple(named)

    def apply(self, mesh: trimesh.Trimesh) -> trimesh.Trimesh:
        """A cleaned copy of a mesh; normals and colours are dropped."""
        if self.repair:
            mesh = repair(mesh)
        if self.seen:
            mesh = keep_seen(mesh)
        if self.components:
            mesh = keep_largest(mesh, self.components)
        if self.holes:
            mesh = close_holes(mesh, self.holes)
        if self.smoothing:
            mesh = smooth(mesh, self.smoothing)
        if self.max_faces:
            mesh = decimate(mesh, self.max_faces)
        return mesh


def keep_largest(mesh: trimesh.Trimesh, count: int) -> trimesh.Trimesh:
    """The `count` connected components with the largest enclosed volume, as one mesh."""
    piece = pieces(mesh)
    volumes = np.abs(np.bincount(piece, weights=signed_volumes(mesh)))
    if len(volumes) <= count:
        return mesh
    return with_faces(mesh, np.isin(piece, np.argsort(-volumes, kind="stable")[:count]))


def keep_seen(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """The connected components that can be seen from outside.

    Rays leave up to `LOOKOUTS` faces of each component in `DIRECTIONS`; a component stays if one of
    them meets nothing.
    """
    piece = pieces(mesh)
    order = np.argsort(piece, kind="stable")
    starts = np.concatenate([[0], np.cumsum(np.bincount(piece))])
    chosen = np.concatenate(
        [
            order[a + np.unique(np.linspace(0, b - a - 1, min(LOOKOUTS, b - a)).astype(int))]
            for a, b in itertools.pairwise(starts)
        ]
    )
    away = DIRECTIONS / np.linalg.norm(DIRECTIONS, axis=1, keepdims=True)
    rays_d = np.tile(away, (len(chosen), 1))
    centres = np.asarray(mesh.vertices)[np.asarray(mesh.faces)[chosen]].mean(axis=1)
    rays_o = np.repeat(centres, len(away), axis=0) + 1e-5 * float(np.linalg.norm(mesh.extents)) * rays_d
    free = np.isnan(cast_rays(mesh, rays_o, rays_d))
    seen = np.unique(np.repeat(piece[chosen], len(away))[free])
    return mesh if len(seen) == len(starts) - 1 else with_faces(mesh, np.isin(piece, seen))


def smooth(mesh: trimesh.Trimesh, rounds: int) -> trimesh.Trimesh:
    """Taubin smoothing by a windowed sinc filter (VTK): noise goes, volume stays."""
    return from_pyvista(to_pyvista(mesh).smooth_taubin(n_iter=max(rounds, 2), pass_band=0.05))


def decimate(mesh: trimesh.Trimesh, max_faces: int) -> trimesh.Trimesh:
    """Quadric decimation to at most `max_faces` faces that keeps a closed surface closed.

    No library guarantees that, so the first result is taken that is closed and encloses the same
    volume within `VOLUME_SHARE`: VTK's (plain, then regularised, which leaves thin triangles), then
    open3d's where it can be loaded. Failing that, the closed result with the nearest volume, and
    failing that an open one, with a warning. Of a surface that was open from the start, the first
    result is taken.

    Raises:
        UserError: the surface cannot be reduced so far.
    """
    if len(mesh.faces) <= max_faces:
        return mesh
    best, torn, change = None, None, np.inf
    for fewer in _decimated(mesh, max_faces):
        if len(fewer.faces) > max_faces:
            continue
        if not mesh.is_watertight:
            return fewer
        if not fewer.is_watertight:
            torn = fewer if torn is None else torn
            continue
        difference = abs(float(fewer.volume) / float(mesh.volume) - 1.0)
        if difference <= VOLUME_SHARE:
            return fewer
        if difference < change:
            best, change = fewer, difference
    if best is not None:
        return best
    if torn is None:
        raise UserError(f"the surface cannot be reduced to {max_faces} faces; raise --max-faces")
    warnings.warn(
        f"reducing the surface to {max_faces} faces tore it; raise --max-faces to keep it closed", stacklevel=2
    )
    return torn


def _decimated(mesh: trimesh.Trimesh, max_faces: int) -> Iterator[trimesh.Trimesh]:
    """The surface decimated in one way after another, each only once it is asked for."""
    for aim in (max_faces, 0.97 * max_faces):
        for regularised in (False, True):
            yield _decimated_by_vtk(mesh, aim, regularised)
        try:
            yield _decimated_by_open3d(mesh, int(aim))
        except (ImportError, OSError):
            continue


def _decimated_by_vtk(mesh: trimesh.Trimesh, max_faces: float, regularised: bool) -> trimesh.Trimesh:
    import pyvista as pv
    from vtkmodules.vtkFiltersCore import vtkQuadricDecimation

    decimation = vtkQuadricDecimation()
    decimation.SetInputData(to_pyvista(mesh))
    decimation.SetTargetReduction(1.0 - 0.99 * max_faces / len(mesh.faces))
    decimation.SetVolumePreservation(True)
    if regularised:
        decimation.SetRegularize(True)
    decimation.Update()
    return from_pyvista(pv.wrap(decimation.GetOutput()))


def _decimated_by_open3d(mesh: trimesh.Trimesh, max_faces: int) -> trimesh.Trimesh:
    import open3d as o3d

    vertices = o3d.utility.Vector3dVector(np.asarray(mesh.vertices, dtype=np.float64))
    surface = o3d.geometry.TriangleMesh(vertices, o3d.utility.Vector3iVector(np.asarray(mesh.faces, dtype=np.int32)))
    fewer = surface.simplify_quadric_decimation(max_faces)
    return without_collapsed(trimesh.Trimesh(np.asarray(fewer.vertices), np.asarray(fewer.triangles), process=False))
