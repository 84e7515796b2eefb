"""Small plots as plain data: where ticks, points and bars lie in pixels; templates/plots.html draws them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from gazenerf.viz.report.blocks import Bar, Bars, Dot, Mark, Scatter, Series, Text
from gazenerf.viz.report.readable import UNMEASURED

COLOURS = ("#2f6fde", "#d9622b", "#2c9c6a", "#a04fc4")

SCATTER_WIDTH, SCATTER_HEIGHT = 360, 300
BARS_WIDTH, BAR_ROW = 400, 20
"""Pixels: width of a bar chart, and height of one bar with its gap."""


def ticks(low: float, high: float, count: int = 5) -> np.ndarray:
    """(N,) round numbers between two limits, about `count` of them."""
    span = max(high - low, 1e-12)
    raw = span / count
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(power * factor for factor in (1.0, 2.0, 5.0, 10.0) if power * factor >= raw)
    return np.arange(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1) * step


def scatter(
    series: Mapping[str, tuple[np.ndarray, np.ndarray]], title: str, x_label: str, y_label: str
) -> Scatter | Text:
    """Points x, y (N,) each of every series, and the line on which both are equal; same scale on both axes."""
    points = {name: np.array([x, y], dtype=np.float64) for name, (x, y) in series.items()}
    known = {name: p[:, np.isfinite(p).all(axis=0)] for name, p in points.items()}
    everything = np.concatenate([p.ravel() for p in known.values()]) if known else np.zeros(0)
    if not everything.size:
        return Text(f"{title}: {UNMEASURED}.")
    low, high = float(everything.min()), float(everything.max())
    pad = 0.08 * max(high - low, 1.0)
    low, high = low - pad, high + pad
    left, right, top, bottom = 46, SCATTER_WIDTH - 10, 24, SCATTER_HEIGHT - 40

    def px(x: float) -> float:
        return round(left + (x - low) / (high - low) * (right - left), 1)

    def py(y: float) -> float:
        return round(bottom - (y - low) / (high - low) * (bottom - top), 1)

    return Scatter(
        title, x_label, y_label, SCATTER_WIDTH, SCATTER_HEIGHT, left, right, top, bottom,
        x_ticks=tuple(Mark(px(tick), f"{tick:g}") for tick in ticks(low, high)),
        y_ticks=tuple(Mark(py(tick), f"{tick:g}") for tick in ticks(low, high)),
        series=tuple(
            Series(name, COLOURS[i % len(COLOURS)], tuple(Dot(px(x), py(y), f"{x:.1f}, {y:.1f}") for x, y in p.T))
            for i, (name, p) in enumerate(known.items())
        ),
        equal=(px(low), py(low), px(high), py(high)),
    )  # fmt: skip


def bars(names: Sequence[str], values: Sequence[float], title: str, unit: str, limit: float = math.nan) -> Bars | Text:
    """A horizontal bar for each name, and a dashed line at the threshold that holds for these values.

    Args:
        names, values: Of the bars; a value that is NaN has none.
        title: Above the plot.
        unit: Below the axis.
        limit: Largest value that passes.
    """
    known = [value for value in values if math.isfinite(value)]
    if not known:
        return Text(f"{title}: {UNMEASURED}.")
    reach = max(known) if math.isnan(limit) else max(*known, limit)
    high = 1.08 * reach or 1.0
    left, right, top = 68, BARS_WIDTH - 14, 44
    bottom = top + BAR_ROW * len(names)

    def px(x: float) -> float:
        return round(left + x / high * (right - left), 1)

    return Bars(
        title, unit, BARS_WIDTH, bottom + 40, left, right, top, bottom,
        ticks=tuple(Mark(px(tick), f"{tick:g}") for tick in ticks(0.0, high)),
        bars=tuple(
            Bar(
                name,
                top + BAR_ROW * (i + 0.5),
                round(px(value) - left, 1) if math.isfinite(value) else 0.0,
                f"{value:.3g} {unit}" if math.isfinite(value) else UNMEASURED,
            )
            for i, (name, value) in enumerate(zip(names, values, strict=True))
        ),
        limit=Mark(px(limit), f"passes up to {limit:g}") if math.isfinite(limit) else None,
    )  # fmt: skip
