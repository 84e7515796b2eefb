"""Frechet distances of features whose distributions are known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from gazenerf.errors import UserError
from gazenerf.evaluation import frechet
from gazenerf.evaluation.frechet import InceptionFeatures, frechet_distance, frechet_estimate, load_features

pytest.importorskip("torchmetrics")


def test_a_shift_and_a_scale_give_the_known_distance():
    truth = np.random.default_rng(0).normal(size=(4000, 3))
    assert frechet_distance(truth, truth) == pytest.approx(0.0, abs=1e-6)
    assert frechet_distance(truth + np.array([0, 3, 0]), truth) == pytest.approx(9.0, rel=1e-6)
    variances = truth.var(axis=0, ddof=1)
    assert frechet_distance(2.0 * truth, truth) == pytest.approx(
        variances.sum() + np.square(truth.mean(axis=0)).sum(), rel=1e-6
    )


def test_the_interval_leaves_out_each_person():
    rng = np.random.default_rng(1)
    features = {
        person: (rng.normal(size=(30, 2)) + np.array([person, 0]), rng.normal(size=(30, 2))) for person in range(4)
    }
    estimate = frechet_estimate(features)
    assert estimate is not None and estimate.method == "jackknife" and estimate.subjects == 4
    everything = [np.concatenate([features[person][side] for person in features]) for side in (0, 1)]
    assert estimate.mean == pytest.approx(frechet_distance(*everything))
    assert estimate.low < estimate.mean < estimate.high and estimate.high - estimate.low > 1.0
    alike = frechet_estimate(dict.fromkeys(range(4), features[0]))
    assert alike is not None and alike.high - alike.low < 0.2


def test_few_pictures_give_less():
    one = np.ones((1, 2))
    assert frechet_estimate({}) is None and frechet_estimate({0: (one, one)}) is None
    two = frechet_estimate({0: (one, one), 1: (2 * one, one)})
    assert two is not None and two.low is None


def test_without_inception_the_distance_has_another_name(tmp_path: Path, monkeypatch):
    monkeypatch.setattr(torch.hub, "get_dir", lambda: str(tmp_path))
    left_out: dict[str, str] = {}
    try:
        features = load_features(left_out)
    except UserError as error:
        pytest.skip(str(error))
    assert features.name == "frechet_alexnet" and "no Inception weights" in left_out["FID"]
    found = features(torch.rand(2, 3, 64, 64))
    assert found.shape == (2, 256) and float(found.std()) > 0


def test_inception_sees_bytes():
    seen = []

    class Network(torch.nn.Module):
        def forward(self, pictures):
            seen.append(pictures)
            return pictures.float().mean((2, 3))

    features = InceptionFeatures(Network())
    assert features.name == "fid" in frechet.NAMES
    np.testing.assert_allclose(features(torch.full((2, 3, 8, 8), 0.5)), np.full((2, 3), 128.0))
    assert seen[0].dtype == torch.uint8


def test_damaged_inception_weights_are_one_line(tmp_path: Path, monkeypatch):
    monkeypatch.setattr(torch.hub, "get_dir", lambda: str(tmp_path))
    (tmp_path / "checkpoints").mkdir()
    (tmp_path / "checkpoints" / frechet.INCEPTION_FILE).write_bytes(b"junk")
    with pytest.raises(UserError, match="cannot load Inception"):
        frechet._inception()
