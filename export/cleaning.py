"""Making a surface fit for use: pieces, smoothing, holes, fewer faces. Each step is optional and has a name."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh

from gazenerf.errors import UserError


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
    """Quadric decimation (VTK, volume preserving) to at most `max_faces` faces."""
    if len(mesh.faces) <= max_faces:
        return mesh
    share = 1.0 - max_faces / len(mesh.faces)
    fewer = from_pyvista(to_pyvista(mesh).decimate(share, volume_preservation=True))
    if len(fewer.faces) > 1.1 * max_faces:
        raise UserError(f"the surface cannot be reduced to {max_faces} faces; {len(fewer.faces)} are left")
    return fewer


def to_pyvista(mesh: trimesh.Trimesh):
    """Geometry as `pyvista.PolyData`."""
    import pyvista as pv

    faces = np.concatenate([np.full((len(mesh.faces), 1), 3), mesh.faces], axis=1)
    return pv.PolyData(np.asarray(mesh.vertices), faces.ravel())


def from_pyvista(surface) -> trimesh.Trimesh:
    """Triangles of a `pyvista.PolyData`, vertices merged."""
    faces = np.asarray(surface.faces).reshape(-1, 4)[:, 1:]
    mesh = trimesh.Trimesh(np.asarray(surface.points, dtype=np.float64), faces, process=False)
    mesh.merge_vertices()
    mesh.update_faces(mesh.nondegenerate_faces())
    mesh.remove_unreferenced_vertices()
    return mesh
