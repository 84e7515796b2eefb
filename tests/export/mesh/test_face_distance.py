"""A mesh against the head model: the distance in the face crop is the distance."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from gazenerf.export.mesh import rays as raycast
from gazenerf.export.mesh.face_distance import distance_in_face_crop
from gazenerf.geometry import Gaze
from gazenerf.head_model import ReferenceHead, load_head_model
from gazenerf.head_model.interface import FACE
from gazenerf.heads.analytic import AnalyticField
from gazenerf.subjects import bundled_subjects, load_subject


@pytest.fixture(scope="module")
def reference():
    subject = load_subject(next(iter(bundled_subjects())))
    return load_head_model().mesh(subject.head_codes, Gaze())


def test_a_face_pushed_outward_reads_as_far_as_it_was_pushed(reference):
    faces = reference.part_faces(FACE)
    for push in (0.0, 0.02):
        vertices = reference.vertices + push * reference.normals
        read = distance_in_face_crop(trimesh.Trimesh(vertices, faces, process=False), reference)
        assert read == pytest.approx(push, abs=1e-3)


def test_what_lies_outside_the_crop_is_not_measured(reference):
    ball = trimesh.creation.icosphere(2, radius=0.1)
    ball.apply_translation([9.0, 0.0, 0.0])
    assert np.isnan(distance_in_face_crop(ball, reference))
    assert ReferenceHead.of(AnalyticField().subject) is None


def test_both_libraries_measure_the_same_distance(monkeypatch):
    pytest.importorskip("open3d", reason="open3d cannot be loaded", exc_type=ImportError)
    box = trimesh.creation.box()
    points = np.random.default_rng(0).uniform(-2, 2, (50, 3))
    fast = raycast.nearest_distance(box, points)
    monkeypatch.setattr(raycast, "ray_scene", lambda mesh: None)
    assert np.allclose(raycast.nearest_distance(box, points), fast, atol=1e-5)
