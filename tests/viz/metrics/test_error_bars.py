"""Error bars against what statistics says of samples whose spread is known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from gazenerf.viz.metrics.error_bars import bootstrap, jackknife


def test_a_bootstrap_of_the_mean_is_the_textbooks():
    values = np.random.default_rng(0).normal(5.0, 2.0, 400)
    assert bootstrap(values, np.mean, draws=2000) == pytest.approx(1.96 * 2.0 / np.sqrt(400), rel=0.1)
    assert bootstrap(values, np.mean, seed=3) == bootstrap(values, np.mean, seed=3)


def test_a_bootstrap_is_scipys_percentile_interval():
    values = np.random.default_rng(4).normal(size=40)
    theirs = stats.bootstrap(
        (values,), np.median, n_resamples=200, method="percentile", rng=np.random.default_rng(7)
    ).confidence_interval
    assert bootstrap(values, np.median, seed=7, draws=200) == pytest.approx(0.5 * (theirs.high - theirs.low))


def test_draws_without_a_finite_statistic_are_left_out_in_silence(recwarn):
    values = np.arange(12.0)
    assert np.isfinite(bootstrap(values, lambda some: np.nan if some.max() < 9.0 else float(some.mean())))
    assert np.isnan(bootstrap(values, lambda some: np.nan)) and not recwarn


def test_a_95_percent_interval_holds_the_truth_about_that_often():
    rng = np.random.default_rng(1)
    held = 0
    for i in range(200):
        values = rng.normal(0.0, 1.0, 30)
        held += abs(np.mean(values)) <= bootstrap(values, np.mean, seed=i, draws=300)
    assert 0.88 <= held / 200 <= 0.99


def test_rows_with_nan_are_left_out_and_two_are_too_few():
    rows = np.array([[1.0, 2.0], [np.nan, 0.0], [3.0, 1.0], [2.0, 2.0]])
    assert np.isfinite(bootstrap(rows, lambda some: float(some.sum(axis=1).mean())))
    assert np.isnan(bootstrap(rows[:3], lambda some: float(some.mean())))
    assert bootstrap([4.0, 4.0, 4.0], np.median) == 0.0


def test_a_jackknife_of_the_mean_is_the_textbooks():
    values = np.random.default_rng(2).normal(0.0, 1.0, 50)
    left_out = [float(np.delete(values, i).mean()) for i in range(50)]
    assert jackknife(left_out) == pytest.approx(1.96 * values.std(ddof=1) / np.sqrt(50))
    assert np.isnan(jackknife([1.0])) and np.isnan(jackknife([1.0, np.nan]))
