"""What every step on a triangle mesh needs: its pieces, its volume, and pyvista's form of it."""

from __future__ import annotations

import numpy as np
import trimesh
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components


def joined(near: np.ndarray, far: np.ndarray, total: int) -> np.ndarray:
    """(total,) number of the group of each thing, of which pairs near (n,), far (n,) are joined."""
    graph = coo_matrix((np.ones(len(near), dtype=bool), (near, far)), shape=(total, total))
    return connected_components(graph, directed=False)[1]


def pieces(mesh: trimesh.Trimesh) -> np.ndarray:
    """(F,) number of the connected component of each face, joined by shared vertices."""
    faces = np.asarray(mesh.faces)
    group = joined(faces[:, [0, 1]].ravel(), faces[:, [1, 2]].ravel(), len(mesh.vertices))
    return np.unique(group[faces[:, 0]], return_inverse=True)[1]


def signed_volumes(mesh: trimesh.Trimesh) -> np.ndarray:
    """(F,) what each face adds to the enclosed volume: its tetrahedron with the middle of the vertices."""
    vertices = np.asarray(mesh.vertices)
    a, b, c = ((vertices - vertices.mean(axis=0))[corner] for corner in np.asarray(mesh.faces).T)
    return np.einsum("ij,ij->i", a, np.cross(b, c)) / 6.0


def with_faces(mesh: trimesh.Trimesh, kept: np.ndarray) -> trimesh.Trimesh:
    """A new mesh of some faces, a mask (F,), and their vertices."""
    faces = np.asarray(mesh.faces)[kept]
    used, numbered = np.unique(faces, return_inverse=True)
    return trimesh.Trimesh(np.asarray(mesh.vertices)[used], numbered.reshape(-1, 3), process=False)


def without_collapsed(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Vertices at one place merged and faces with a repeated vertex dropped, in place.

    Thin faces stay: dropping one would open a hole.
    """
    mesh.merge_vertices()
    a, b, c = np.asarray(mesh.faces).T
    mesh.update_faces((a != b) & (b != c) & (c != a))
    mesh.remove_unreferenced_vertices()
    return mesh


def to_pyvista(mesh: trimesh.Trimesh):
    """Geometry as `pyvista.PolyData`."""
    import pyvista as pv

    faces = np.concatenate([np.full((len(mesh.faces), 1), 3), mesh.faces], axis=1)
    return pv.PolyData(np.asarray(mesh.vertices), faces.ravel())


def from_pyvista(surface) -> trimesh.Trimesh:
    """Triangles of a `pyvista.PolyData`, vertices merged."""
    faces = np.asarray(surface.faces).reshape(-1, 4)[:, 1:]
    return without_collapsed(trimesh.Trimesh(np.asarray(surface.points, dtype=np.float64), faces, process=False))
