"""Rows of people become means with intervals."""

from __future__ import annotations

import numpy as np
import pytest

from gazenerf.evaluation.paper_summary import summarised
from gazenerf.evaluation.redirection import EMBEDDING, UNITS, features_names
from gazenerf.evaluation.rows import packed


def test_people_count_alike_whatever_they_have_of_pairs():
    rows = [(0, {"gaze_deg": 1.0}), *[(1, {"gaze_deg": 4.0})] * 3, (2, {"gaze_deg": 1.0, "psnr": np.inf})]
    measurements, subjects = summarised(rows)
    assert measurements["gaze_deg"].mean == 2.0 and measurements["gaze_deg"].subjects == 3
    assert subjects == {
        "0": {"pairs": 1, "gaze_deg": 1.0}, "1": {"pairs": 3, "gaze_deg": 4.0}, "2": {"pairs": 1, "gaze_deg": 1.0}
    }  # fmt: skip
    assert "psnr" not in measurements, "not finite"


def test_other_people_are_compared_by_their_embeddings():
    rows = [
        (0, {EMBEDDING: packed(np.array([1.0, 0.0])), "identity_similarity": 0.9}),
        (0, {EMBEDDING: packed(np.array([0.0, 1.0])), "identity_similarity": 0.7}),
        (1, {EMBEDDING: packed(np.array([0.6, 0.8])), "identity_similarity": 0.8}),
    ]
    measurements, subjects = summarised(rows)
    assert subjects["0"]["identity_others"] == pytest.approx(0.7) == subjects["1"]["identity_others"]
    assert measurements["identity_similarity"].mean == pytest.approx(0.8)
    assert "identity_others" not in summarised(rows[:2])[0], "there is nobody else"


def test_distances_are_of_all_pictures():
    pytest.importorskip("torchmetrics")
    made, truth = features_names("frechet_alexnet")
    rng = np.random.default_rng(0)
    rows = [(person, {made: packed(v + 1.0), truth: packed(v)}) for person in range(3) for v in rng.normal(size=(9, 2))]
    measurements, subjects = summarised(rows)
    assert measurements["frechet_alexnet"].mean == pytest.approx(2.0, rel=1e-3)
    assert "frechet_alexnet" not in subjects["0"] and set(measurements) <= set(UNITS)
