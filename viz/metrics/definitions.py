"""What a metric is: its name, unit, meaning and thresholds, and, once measured, its value with an error bar.

Definitions are data. Each family's stand in the module that measures it; `gazenerf.viz.metrics.families`
collects them. The tables of docs/consistency.md and docs/consistency-of-others.md, the reports, the
thresholds of `--fail-on` and the matrix of faults are made from them.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import KW_ONLY, dataclass
from typing import Any, Literal

from gazenerf.errors import UserError

Check = Literal["field", "frames"]
"""`field`: `gazenerf check`; `frames`: `gazenerf check --frames`."""

ANY, NOT_NEGATIVE, SHARE = (-math.inf, math.inf), (0.0, math.inf), (0.0, 1.0)
"""Bounds of values."""

COSINE = (-1.0, 1.0)
DECIBELS = (0.0, 100.0)
"""PSNR is cut at 100."""


@dataclass(frozen=True)
class Finding:
    """When a metric reports a fault of the exact scene (`gazenerf.viz.selftest`).

    Attributes:
        limit: A value worse than this is a finding. The scene has no error of its own, so limits are
            closer than the thresholds for trained fields.
        decimals: Shown in the matrix of faults.
    """

    limit: float
    decimals: int


@dataclass(frozen=True)
class Definition:
    """One metric, not yet measured.

    Attributes:
        name: Used by `--fail-on` and in report.json.
        label: For people.
        unit: Empty for shares, correlations and the like.
        meaning: One plain sentence for somebody who has never heard of it.
        passes, warns: Thresholds; a value worse than the first warns, one worse than the second fails.
        higher_is_better: Which side is worse.
        group: Heading in the report.
        advice: One sentence: what a warning means for the user and what to do.
        bounds: Values lie between these, and so do their intervals.
        method: How exactly it is computed, for the docs.
        checks: The checks that measure it.
        finding: When it reports a fault of the exact scene; None leaves it out of the matrix of faults.
    """

    name: str
    label: str
    unit: str
    meaning: str
    _: KW_ONLY
    passes: float
    warns: float
    higher_is_better: bool = False
    group: str = ""
    advice: str = ""
    bounds: tuple[float, float] = ANY
    method: str = ""
    checks: tuple[Check, ...] = ("field",)
    finding: Finding | None = None


@dataclass(frozen=True)
class Metric:
    """One number of the verdict.

    Attributes:
        definition: What it is.
        value: NaN when it could not be measured.
        error: Half width of the value's 95 % interval, same unit; NaN when unknown.
        reference: What the same metric reads between two renders of the reference head; NaN when unknown.
    """

    definition: Definition
    value: float = math.nan
    error: float = math.nan
    reference: float = math.nan

    @property
    def name(self) -> str:
        """Used by `--fail-on` and in report.json."""
        return self.definition.name

    @property
    def label(self) -> str:
        """For people."""
        return self.definition.label

    @property
    def unit(self) -> str:
        """Of value, error and reference."""
        return self.definition.unit

    @property
    def interval(self) -> tuple[float, float]:
        """Both ends of the value's 95 % interval, cut at the bounds of the definition; NaN when unknown."""
        low, high = self.definition.bounds
        if not math.isfinite(self.value + self.error):
            return math.nan, math.nan
        return max(low, self.value - self.error), min(high, self.value + self.error)

    @property
    def verdict(self) -> str:
        """`pass`, `warn`, `fail` or `unmeasured`."""
        if not math.isfinite(self.value):
            return "unmeasured"
        if not self.crosses(self.definition.passes):
            return "pass"
        return "fail" if self.crosses(self.definition.warns) else "warn"

    def crosses(self, threshold: float) -> bool:
        """Whether the value lies on the wrong side of a threshold, or was not measured."""
        if not math.isfinite(self.value):
            return True
        return self.value < threshold if self.definition.higher_is_better else self.value > threshold

    def to_dict(self) -> dict[str, Any]:
        """The metric as report.json holds it."""
        definition = self.definition
        return {
            "name": definition.name,
            "label": definition.label,
            "unit": definition.unit,
            "value": self.value,
            "passes": definition.passes,
            "warns": definition.warns,
            "higher_is_better": definition.higher_is_better,
            "group": definition.group,
            "error": self.error,
            "reference": self.reference,
            "meaning": definition.meaning,
            "verdict": self.verdict,
        }


def check_names(names: Iterable[str], definitions: Iterable[Definition]) -> None:
    """Refuse names of no metric.

    Raises:
        UserError: a name is not among the definitions.
    """
    known = [definition.name for definition in definitions]
    for name in names:
        if name not in known:
            raise UserError(f"unknown metric {name!r}; there are {', '.join(known)}")
