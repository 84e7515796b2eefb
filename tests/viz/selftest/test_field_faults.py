"""Faults of known size on a trained field are read at their size beside its own errors."""

from __future__ import annotations

import numpy as np
import pytest

import gazenerf
from gazenerf.geometry import Gaze
from gazenerf.head_model import ReferenceHead
from gazenerf.head_model.interface import EYE_LEFT, FACE
from gazenerf.viz.selftest.field_faults import FIELD_FAULTS, MisledHead, moved_eye, read_field, turned_mesh


@pytest.fixture(scope="module")
def head():
    return gazenerf.load("jana")


def test_meshes_are_changed_as_told(head) -> None:
    reference = ReferenceHead.of(head.subject)
    assert reference is not None
    mesh = reference.at(Gaze())
    turned = turned_mesh(mesh, 90.0)
    np.testing.assert_allclose(turned.vertices[:, 0], mesh.vertices[:, 2], atol=1e-5)
    np.testing.assert_allclose(turned.landmarks["30"][0], mesh.landmarks["30"][2], atol=1e-5)
    np.testing.assert_allclose(turned.normals[:, 2], -mesh.normals[:, 0], atol=1e-5)
    moved = moved_eye(mesh, (1.0, 0.0, 0.0))
    eye, face = np.unique(mesh.part_faces(EYE_LEFT)), np.unique(mesh.part_faces(FACE))
    np.testing.assert_allclose(
        (moved.vertices - mesh.vertices)[eye], np.tile([0.01, 0.0, 0.0], (len(eye), 1)), atol=1e-6
    )
    assert np.array_equal(moved.vertices[face], mesh.vertices[face])
    np.testing.assert_allclose(moved.eye_centres - mesh.eye_centres, [[0.01, 0.0, 0.0], [0.0, 0.0, 0.0]], atol=1e-6)


def test_a_misled_head_looks_where_it_is_not_told(head) -> None:
    misled = MisledHead(head, FIELD_FAULTS["eyes turn by 20 % less than told"].looks)
    assert misled.at(Gaze(0.1, -0.2)).gaze.degrees == pytest.approx(Gaze(0.08, -0.16).degrees)
    assert (
        misled.subject is head.subject and misled.trained_range == head.trained_range and misled.device == head.device
    )


def test_faults_are_read_at_their_size(head) -> None:
    names = "reference moved 2.0 mm forward", "left eye of the reference 1.0 mm further out"
    faults = [FIELD_FAULTS[name] for name in names]
    without = read_field(head, None, [fault.metric for fault in faults], swept=False, views=3, size=128)
    for fault in faults:
        with_it = read_field(head, fault, [fault.metric], swept=False, views=3, size=128)[fault.metric]
        assert without[fault.metric] < 0.3 * fault.size
        assert with_it == pytest.approx(fault.size, rel=0.25)
