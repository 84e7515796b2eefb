"""How sure a number is: half widths of 95 % intervals by resampling views, pairs and gazes."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

DRAWS = 200
NORMAL_95 = 1.96

Reading = tuple[float, float]
"""A value and half the width of its 95 % interval; NaN where unknown."""

UNKNOWN: Reading = (math.nan, math.nan)


def bootstrap(
    values: Sequence[float] | np.ndarray, statistic: Callable[[np.ndarray], float], seed: int = 0, draws: int = DRAWS
) -> float:
    """Half the 95 % percentile interval of a statistic over values drawn again with replacement (Efron 1979).

    It is that of `scipy.stats.bootstrap`, which cannot leave out draws whose statistic is not finite.

    Args:
        values: (N, ...), rows are drawn; rows with NaN are left out.
        statistic: Rows (N, ...) to a number.
        seed: Of the draws.
        draws: How many.

    Returns:
        NaN for fewer than three rows, or where the statistic of most draws is not finite.
    """
    rows = np.asarray(values, dtype=np.float64)
    rows = rows[np.isfinite(rows).reshape(len(rows), -1).all(axis=1)]
    if len(rows) < 3:
        return math.nan
    rng = np.random.default_rng(seed)
    drawn = np.array([float(statistic(rows[rng.integers(0, len(rows), len(rows))])) for _ in range(draws)])
    found = drawn[np.isfinite(drawn)]
    if len(found) < draws // 2:
        return math.nan
    low, high = np.percentile(found, [2.5, 97.5])
    return 0.5 * float(high - low)


def summary(
    values: Sequence[float] | np.ndarray, statistic: Callable[[np.ndarray], float] = np.median, seed: int = 0
) -> Reading:
    """A statistic of the finite values and its bootstrapped error; `np.max` and `np.min` have no error bar."""
    known = np.asarray(values, dtype=np.float64)
    known = known[np.isfinite(known)]
    if not len(known):
        return UNKNOWN
    extreme = statistic in (np.max, np.min)
    return float(statistic(known)), math.nan if extreme else bootstrap(known, statistic, seed)


def jackknife(estimates: Sequence[float]) -> float:
    """Half the 95 % interval from estimates that each leave out one of their groups (Quenouille, Tukey).

    Returns:
        NaN for fewer than two estimates, or where one is NaN.
    """
    values = np.asarray(estimates, dtype=np.float64)
    count = len(values)
    if count < 2 or not np.isfinite(values).all():
        return math.nan
    return NORMAL_95 * float(np.sqrt((count - 1) / count * ((values - values.mean()) ** 2).sum()))


def share_error(share: float, count: int) -> float:
    """Half the 95 % interval of a share of `count` items (Wilson 1927), which is not 0 where all of them agree."""
    if not count:
        return math.nan
    z = NORMAL_95
    return z / (1.0 + z * z / count) * math.sqrt(share * (1.0 - share) / count + z * z / (4.0 * count * count))
