"""Numbers as a reader sees them."""

from __future__ import annotations

import math
from collections.abc import Iterable

UNMEASURED = "not measured"


def number(value: float | None, unit: str = "", *, bare: bool = False) -> str:
    """A value with its unit, about three digits; `not measured` for NaN and None; without the unit where `bare`."""
    if value is None or not math.isfinite(value):
        return UNMEASURED
    size = abs(value)
    if size < 0.01:
        text = f"{value:.2g}"
    elif size >= 1000.0:
        text = f"{value:,.0f}"
    else:
        digits = 0 if size >= 100.0 else 1 if size >= 10.0 else 3 if size < 1.0 or not unit else 2
        text = f"{value:.{digits}f}"
    return text if bare else f"{text} {unit}".strip()


def degrees(value: float) -> str:
    """A whole angle with its sign, such as `+20°`."""
    return f"{value:+.0f}°"


def listed(names: Iterable[str]) -> str:
    """Names as a sentence lists them: `a, b and c`."""
    *first, last = names
    return f"{', '.join(first)} and {last}" if first else last


def clauses(parts: Iterable[str]) -> str:
    """Clauses that each have their own verb, as one sentence joins them: `a, b, and c`."""
    *first, last = parts
    return f"{', '.join(first)}, and {last}" if first else last
