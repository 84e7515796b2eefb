"""The face crop on landmarks whose ball is known, and on the bundled head."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gazenerf.evaluation.face_crop import face_crop
from gazenerf.geometry import Gaze
from gazenerf.head_model import load_head_model
from gazenerf.heads.analytic import AnalyticField
from gazenerf.subjects import Codes
from gazenerf.viz.selftest.exact_scene import scene_mesh

MARKS = {
    "36": np.array([-0.5, 0.3, 0.8]),
    "39": np.array([-0.2, 0.3, 0.9]),
    "42": np.array([0.2, 0.3, 0.9]),
    "45": np.array([0.5, 0.3, 0.8]),
    "33": np.array([0.0, -0.2, 0.9]),
}


def test_the_ball_is_the_benchmarks():
    crop = face_crop(replace(scene_mesh(AnalyticField(), 2), landmarks=MARKS))
    assert crop is not None
    assert crop.centre == pytest.approx([0.0, -0.05, 0.9]), "0.3 of the nose's 0.5 above its base"
    assert crop.radius == pytest.approx(1.4 * (1.0 + 0.5) / 2)
    near, far = (crop.centre + np.array([0.0, crop.radius + step, 0.0]) for step in (-1e-6, 1e-6))
    assert crop.contains(np.stack([near, far])).tolist() == [True, False]
    metres = crop.scaled(0.1)
    assert metres.contains(np.stack([near, far]) * 0.1).tolist() == [True, False]


@pytest.mark.parametrize("name", MARKS)
def test_a_missing_landmark_is_no_crop(name):
    marks = {key: value for key, value in MARKS.items() if key != name}
    assert face_crop(replace(scene_mesh(AnalyticField(), 2), landmarks=marks)) is None


def test_it_holds_the_bundled_heads_face_and_not_its_back():
    model = load_head_model()
    mesh = model.mesh(Codes(*(np.zeros(size, np.float32) for size in model.code_sizes)), Gaze())
    crop = face_crop(mesh)
    assert crop is not None
    inside = crop.contains(mesh.vertices)
    assert 60.0 < crop.radius * mesh.metres_per_unit * 1000.0 < 120.0, "millimetres"
    assert all(crop.contains(mesh.landmarks[str(i)]) for i in (8, 19, 24, 30, 48, 54)), "chin, brows, nose, mouth"
    back = mesh.vertices[:, 2] < 0.0
    assert inside.any() and not inside[back].any()
