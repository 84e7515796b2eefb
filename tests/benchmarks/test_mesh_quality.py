"""The benchmark of mesh settings tells a good surface from one that is off, and good normals from turned ones."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from benchmarks.mesh_quality import Reference, gradient_normals, hard_light, measured
from gazenerf.export import MeshOptions
from gazenerf.geometry import Gaze
from gazenerf.head_model import ReferenceHead
from gazenerf.head_model.interface import FACE
from gazenerf.heads.analytic import AnalyticField
from gazenerf.loading import load


@pytest.fixture(scope="module")
def head():
    reference = ReferenceHead.of(load("mia").subject)
    assert reference is not None
    return reference.at(Gaze())


@pytest.fixture(scope="module")
def face(head) -> trimesh.Trimesh:
    return trimesh.Trimesh(head.vertices, head.part_faces(FACE), vertex_normals=head.normals, process=False)


def test_the_head_model_is_at_its_own_place(head, face):
    reference, mm = Reference(head), 1000.0 * head.metres_per_unit
    own = np.unique(face.faces)
    assert reference.distances(np.asarray(face.vertices)[own], mm)["p90_mm"] < 1e-2
    assert max(reference.normal_error(face, np.asarray(head.normals))) < 0.1


def test_a_millimetre_outward_reads_as_one_and_turned_normals_as_turned(head, face):
    reference, mm = Reference(head), 1000.0 * head.metres_per_unit
    own = np.unique(face.faces)
    found = reference.distances((np.asarray(face.vertices) + head.normals / mm)[own], mm)
    assert found["median_mm"] == pytest.approx(1.0, abs=0.1) and found["outward_mm"] == pytest.approx(1.0, abs=0.1)
    assert min(reference.normal_error(face, -np.asarray(head.normals))) > 179.0


def test_a_row_is_the_mesh_s_and_the_gradient_is_the_sphere_s(head):
    bound = AnalyticField(sharpness=0.1)
    row, mesh = measured(bound, Reference(head), MeshOptions(resolution=48, threshold=100.0, colours=False))
    assert row["watertight"] == mesh.is_watertight and row["faces"] == len(mesh.faces) and row["level"] == 100.0
    away = (np.asarray(mesh.vertices) - bound.face.centre) / np.asarray(bound.face.radii) ** 2
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    assert np.median((gradient_normals(bound, mesh, 0.01) * away).sum(axis=1)) > 0.99


def test_light_falls_from_the_side_that_normals_face(face, head):
    lit, turned = (np.asarray(hard_light(face, sign * head.normals, 64), dtype=float) for sign in (1.0, -1.0))
    shown = lit < 255.0
    assert shown.any() and lit[shown].mean() > 2.0 * np.where(turned < 255.0, turned, 0.0)[shown].mean()
