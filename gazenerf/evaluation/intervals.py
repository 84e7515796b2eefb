"""A mean over subjects and how far it would move with other subjects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy import stats

SHARE = 0.95
FEW = 10
"""Below so many subjects Student's t takes the place of the bootstrap, whose intervals are too narrow there."""

RESAMPLES = 9999


@dataclass(frozen=True)
class Estimate:
    """A number with its interval.

    Attributes:
        mean: Over subjects.
        low, high: Ends of the interval of `SHARE`; None where too few give none.
        subjects: How many.
        method: How the interval was made: `bootstrap` (bias-corrected and accelerated, over subjects), `t`,
            `jackknife` (of a number that only all pictures together have) or `none`.
    """

    mean: float
    low: float | None
    high: float | None
    subjects: int
    method: str

    def to_dict(self) -> dict[str, Any]:
        """For JSON, five digits."""
        return {
            name: float(f"{value:.5g}") if isinstance(value, float) else value for name, value in asdict(self).items()
        }


def over_subjects(values: Sequence[float]) -> Estimate:
    """The mean of one value a subject, with its interval.

    Args:
        values: (S,) finite, at least one.

    Raises:
        ValueError: there is none.
    """
    found = np.asarray(values, dtype=np.float64)
    if not found.size:
        raise ValueError("a mean over subjects needs at least one")
    mean, count = float(found.mean()), len(found)
    if count == 1:
        return Estimate(mean, None, None, 1, "none")
    if np.ptp(found) < 1e-12 * max(1.0, abs(mean)):
        return Estimate(mean, mean, mean, count, "t" if count < FEW else "bootstrap")
    if count < FEW:
        return _t_interval(mean, float(stats.sem(found)), count, "t")
    result = stats.bootstrap(
        (found,), np.mean, confidence_level=SHARE, n_resamples=RESAMPLES, method="BCa", rng=np.random.default_rng(0)
    )
    interval = result.confidence_interval
    return Estimate(mean, float(interval.low), float(interval.high), count, "bootstrap")


def jackknifed(whole: float, without_each: Sequence[float], subjects: int) -> Estimate:
    """The interval of a number that only all subjects together have, by leaving each of them out.

    Args:
        whole: Of all subjects.
        without_each: (S,) the same without each subject; empty where that cannot be.
        subjects: How many there are.
    """
    count = len(without_each)
    if count < 2:
        return Estimate(whole, None, None, subjects, "none")
    left_out = np.asarray(without_each, dtype=np.float64)
    error = float(np.sqrt((count - 1) / count * np.square(left_out - left_out.mean()).sum()))
    return _t_interval(whole, error, count, "jackknife")


def _t_interval(mean: float, error: float, count: int, method: str) -> Estimate:
    reach = float(stats.t.ppf(0.5 + SHARE / 2, count - 1)) * error
    return Estimate(mean, mean - reach, mean + reach, count, method)
