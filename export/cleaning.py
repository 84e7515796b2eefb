"""Making a surface fit for use: pieces, smoothing, holes, fewer faces. Each step is optional and has a name."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import trimesh

from gazenerf.errors import UserError

VOLUME_SHARE = 0.01
"""Change of the enclosed volume that decimation may cause where another way causes less."""


@dataclass(frozen=True)
class Cleaning:
    """What to do to a surface, in this order.

    Attributes:
        components: Connected pieces to keep, those that enclose most; 0 keeps all.
        smoothing: Rounds of Taubin smoothing, which keeps the volume; 0 for none.
        max_faces: Quadric decimation to at most this many faces; None for no limit.
    """

    components: int = 0
    smoothing: int = 0
    max_faces: int | None = None

    def __post_init__(self) -> None:
        if not 0 <= self.smoothing <= 200:
            raise UserError(f"--smooth goes from 0 to 200 rounds, got {self.smoothing}")
        if self.max_faces is not None and self.max_faces < 100:
            raise UserError(f"--max-faces must be at least 100, got {self.max_faces}")

    def steps(self) -> tuple[str, ...]:
        """The names of the steps, for sidecars."""
        named = []
        if self.components:
            named.append(f"largest {self.components} component(s) kept")
        if self.smoothing:
            named.append(f"Taubin smoothing, {self.smoothing} rounds")
        if self.max_faces:
            named.append(f"quadric decimation to at most {self.max_faces} faces")
        return tuple(named)

    def apply(self, mesh: trimesh.Trimesh) -> trimesh.Trimesh:
        """A cleaned copy of a mesh; normals and colours are dropped."""
        if self.components:
            mesh = keep_largest(mesh, self.components)
        if self.smoothing:
            mesh = smooth(mesh, self.smoothing)
        if self.max_faces:
            mesh = decimate(mesh, self.max_faces)
        return mesh


def keep_largest(mesh: trimesh.Trimesh, count: int) -> trimesh.Trimesh:
    """The `count` connected components with the largest enclosed volume, as one mesh."""
    pieces = mesh.split(only_watertight=False)
    if len(pieces) <= count:
        return mesh
    order = sorted(pieces, key=lambda piece: abs(float(piece.volume)), reverse=True)[:count]
    kept = trimesh.util.concatenate(order)
    assert isinstance(kept, trimesh.Trimesh)
    return kept


def smooth(mesh: trimesh.Trimesh, rounds: int) -> trimesh.Trimesh:
    """Taubin smoothing by a windowed sinc filter (VTK): noise goes, volume stays."""
    return from_pyvista(to_pyvista(mesh).smooth_taubin(n_iter=max(rounds, 2), pass_band=0.05))


def decimate(mesh: trimesh.Trimesh, max_faces: int) -> trimesh.Trimesh:
    """Quadric decimation to at most `max_faces` faces that keeps a closed surface closed.

    No library guarantees that, so the first result is taken that is closed and encloses the same
    volume within `VOLUME_SHARE`: VTK's (regularised, then plain), then open3d's where it can be
    loaded. Failing that, the closed result with the nearest volume, and failing that an open one,
    with a warning. Of a surface that was open from the start, the first result is taken.

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
        for regularised in (True, False):
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


def to_pyvista(mesh: trimesh.Trimesh):
    """Geometry as `pyvista.PolyData`."""
    import pyvista as pv

    faces = np.concatenate([np.full((len(mesh.faces), 1), 3), mesh.faces], axis=1)
    return pv.PolyData(np.asarray(mesh.vertices), faces.ravel())


def from_pyvista(surface) -> trimesh.Trimesh:
    """Triangles of a `pyvista.PolyData`, vertices merged."""
    faces = np.asarray(surface.faces).reshape(-1, 4)[:, 1:]
    return without_collapsed(trimesh.Trimesh(np.asarray(surface.points, dtype=np.float64), faces, process=False))


def without_collapsed(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Vertices at one place merged and faces with a repeated vertex dropped, in place.

    Thin faces stay: dropping one would open a hole.
    """
    mesh.merge_vertices()
    a, b, c = np.asarray(mesh.faces).T
    mesh.update_faces((a != b) & (b != c) & (c != a))
    mesh.remove_unreferenced_vertices()
    return mesh
