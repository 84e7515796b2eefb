"""The landmark table: what ships, what other head models get, and files that are none."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from gazenerf.errors import UserError
from gazenerf.geometry import Gaze
from gazenerf.photographs.correspondence import (
    BUNDLED,
    MOST_SPREAD_MM,
    STANDARD_AMONG_DENSE,
    LandmarkTable,
    pose_features,
    table_for,
)
from gazenerf.subjects import Codes


def test_the_bundled_table_fits_the_bundled_head(model):
    table = table_for(model, dense=True)
    assert table.has_irises and len(table.landmarks) > 400 and table.spread_mm[:-2].max() < MOST_SPREAD_MM
    assert len(table.without_irises().landmarks) == len(table.vertices)
    mesh = model.mesh(Codes(*(np.zeros(size) for size in model.code_sizes)), Gaze())
    places = dict(zip(table.landmarks.tolist(), mesh.vertices[table.vertices].tolist(), strict=False))
    for dense, name in zip(STANDARD_AMONG_DENSE, range(68), strict=True):
        if name >= 17 and dense in places:  # the jaw's points slide
            assert np.linalg.norm(np.array(places[dense]) - mesh.landmarks[str(name)]) < 0.12, name
    sides = np.array(places[263]), np.array(places[33])
    np.testing.assert_allclose(sides[0] * [-1, 1, 1], sides[1], atol=0.05)


def test_other_models_and_detectors_get_the_standard_landmarks(model):
    for dense in (False, True):
        table = LandmarkTable.standard(model, dense)
        assert (table.vertices == model.landmark_vertices).all() and table.has_irises == dense
    assert len(table_for(model, dense=False).landmarks) == 68


def test_pose_features_are_zero_for_a_frontal_view():
    ahead = pose_features(torch.tensor([0.0, 0.0, 9.0]), torch.zeros(2))
    assert (ahead == 0).all()
    beside = pose_features(torch.tensor([1.0, 0.0, 1.0]), torch.tensor([0.1, 0.2]))
    np.testing.assert_allclose(beside, [np.pi / 4, 0, np.pi**2 / 16, 0, 0, 0.1, 0.2], atol=1e-6)


@pytest.mark.parametrize("fault", ["absent", "text", "format", "model", "shape", "nan", "missing", "bomb"])
def test_what_is_no_table_is_refused_in_one_line(tmp_path, model, fault):
    file = tmp_path / "table.npz"
    with np.load(BUNDLED, allow_pickle=False) as bundled:
        arrays = dict(bundled)
    changes = {
        "format": {"format": np.array("other")},
        "model": {"model": np.array("other")},
        "shape": {"offset_mm": np.zeros((3, 2))},
        "nan": {"noise_mm": np.full(470, np.nan)},
        "bomb": {"more": np.zeros(5_000_000)},
    }
    if fault == "text":
        file.write_text("no archive")
    elif fault != "absent":
        arrays |= changes.get(fault, {})
        if fault == "missing":
            del arrays["noise_mm"]
        np.savez_compressed(file, **arrays)
    with pytest.raises(UserError, match="table") as refused:
        table_for(model, True, file)
    assert "\n" not in str(refused.value)
