"""Intervals hold the mean of subjects as often as they claim."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from gazenerf.evaluation.intervals import jackknifed, over_subjects


@pytest.mark.parametrize(("subjects", "method", "least"), [(3, "t", 0.90), (6, "t", 0.90), (15, "bootstrap", 0.85)])
def test_the_true_mean_lies_inside_about_as_often_as_said(subjects, method, least):
    rng = np.random.default_rng(subjects)
    found = [over_subjects(list(rng.normal(7.0, 2.0, subjects))) for _ in range(60)]
    assert {estimate.method for estimate in found} == {method}
    assert least <= np.mean([estimate.low <= 7.0 <= estimate.high for estimate in found])
    widths = np.median([estimate.high - estimate.low for estimate in found])
    expected = 2.0 * stats.t.ppf(0.975, subjects - 1) * 2.0 / np.sqrt(subjects)
    assert 0.6 * expected < widths < 1.3 * expected


def test_a_known_interval():
    estimate = over_subjects([1.0, 2.0, 3.0])
    assert estimate.mean == 2.0 and estimate.subjects == 3
    assert estimate.high - 2.0 == pytest.approx(4.3027 * np.sqrt(1 / 3), rel=1e-4)


def test_one_subject_has_none_and_equal_ones_have_a_point():
    assert over_subjects([4.0]).to_dict() == {
        "mean": 4.0, "low": None, "high": None, "subjects": 1, "method": "none"
    }  # fmt: skip
    assert over_subjects([2.0] * 12).low == 2.0 == over_subjects([2.0] * 3).high
    with pytest.raises(ValueError, match="at least one"):
        over_subjects([])


def test_the_same_values_give_the_same_interval():
    values = list(np.random.default_rng(0).normal(size=20))
    assert over_subjects(values) == over_subjects(values)


def test_the_jackknife_of_a_mean_is_the_t_interval():
    values = np.array([1.0, 4.0, 2.0, 7.0])
    made = jackknifed(values.mean(), [np.delete(values, i).mean() for i in range(4)], 4)
    assert (made.low, made.high) == pytest.approx((over_subjects(list(values)).low, over_subjects(list(values)).high))
    assert made.method == "jackknife" and jackknifed(3.0, [2.0], 2).low is None
