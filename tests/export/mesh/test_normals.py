"""Normals are those of the triangles, whatever else a mesh carries."""

from __future__ import annotations

import numpy as np
import trimesh

from gazenerf.export import MeshOptions, extract_part
from gazenerf.export.mesh.normals import vertex_normals
from gazenerf.heads.analytic import AnalyticField


def test_normals_of_a_sphere_point_away_from_its_middle():
    ball = trimesh.creation.icosphere(4)
    carried = trimesh.Trimesh(ball.vertices, ball.faces, vertex_normals=-ball.vertices, process=False)
    assert (vertex_normals(carried) * ball.vertices).sum(axis=1).min() > 0.999


def test_the_corner_of_a_cube_faces_along_its_diagonal_however_it_is_cut():
    box = trimesh.creation.box()
    expected = np.sign(box.vertices) / np.sqrt(3.0)
    assert np.allclose(vertex_normals(box), expected, atol=1e-6)


def test_vertices_without_area_get_unit_normals_too():
    mesh = trimesh.Trimesh(
        [[0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 2, 0], [0, 0, 4]], [[0, 1, 2], [3, 3, 3]], process=False
    )
    found = vertex_normals(mesh)
    assert np.allclose(np.linalg.norm(found, axis=1), 1.0) and np.allclose(found[:3], [0, 0, 1])


def test_written_normals_are_those_of_the_smoothed_and_reduced_surface():
    options = MeshOptions(resolution=64, threshold=100.0, smoothing=10, max_faces=2000, colours=False)
    mesh = extract_part(AnalyticField(sharpness=0.1), "face", options).mesh
    bare = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    assert np.allclose(mesh.vertex_normals, bare.vertex_normals, atol=1e-6)
