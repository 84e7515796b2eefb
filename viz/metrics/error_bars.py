"""How sure a number is: half widths of 95 % intervals by resampling views, pairs and gazes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

DRAWS = 200
NORMAL_95 = 1.96


def bootstrap(
    values: Sequence[Any] | np.ndarray, statistic: Callable[[np.ndarray], Any], seed: int = 0, draws: int = DRAWS
) -> float:
    """Half the 95 % percentile interval of a statistic over values drawn again with replacement (Efron 1979).

    Args:
        values: (N, ...), rows are drawn; rows with NaN are left out.
        statistic: Rows (N, ...) to a number.
        seed: Of the draws.

    Returns:
        NaN for fewer than three rows.
    """
    rows = np.asarray(values, dtype=np.float64)
    rows = rows[np.isfinite(rows).reshape(len(rows), -1).all(axis=1)]
    if len(rows) < 3:
        return float("nan")
    rng = np.random.default_rng(seed)
    found = np.array([float(statistic(rows[rng.integers(0, len(rows), len(rows))])) for _ in range(draws)])
    found = found[np.isfinite(found)]
    if len(found) < draws // 2:
        return float("nan")
    low, high = np.percentile(found, [2.5, 97.5])
    return 0.5 * float(high - low)


def jackknife(estimates: Sequence[float]) -> float:
    """Half the 95 % interval from estimates that each leave out one of their groups (Quenouille, Tukey).

    Returns:
        NaN for fewer than two estimates, or where one is NaN.
    """
    values = np.asarray(estimates, dtype=np.float64)
    count = len(values)
    if count < 2 or not np.isfinite(values).all():
        return float("nan")
    return NORMAL_95 * float(np.sqrt((count - 1) / count * ((values - values.mean()) ** 2).sum()))
