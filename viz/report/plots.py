"""Small plots as SVG inside a page; they take the page's colour, so they are right in light and dark."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from html import escape

import numpy as np

SERIES = ("#2f6fde", "#d9622b", "#2c9c6a", "#a04fc4")
WIDTH, HEIGHT = 360, 300
LEFT, RIGHT, TOP, BOTTOM = 46, 10, 24, 40


def ticks(low: float, high: float, count: int = 5) -> np.ndarray:
    """Round numbers between two limits, about `count` of them."""
    span = max(high - low, 1e-12)
    raw = span / count
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(power * factor for factor in (1.0, 2.0, 5.0, 10.0) if power * factor >= raw)
    return np.arange(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1) * step


def scatter(series: Mapping[str, tuple[np.ndarray, np.ndarray]], title: str, x_label: str, y_label: str) -> str:
    """Points (x, y) of each series with the line on which both are equal, same scale on both axes."""
    points = {name: np.array([x, y], dtype=np.float64) for name, (x, y) in series.items()}
    known = [p[:, np.isfinite(p).all(axis=0)] for p in points.values()]
    everything = np.concatenate([p.ravel() for p in known]) if known else np.zeros(0)
    if not everything.size:
        return f"<p class=quiet>{escape(title)}: not measured.</p>"
    low, high = float(everything.min()), float(everything.max())
    pad = 0.08 * max(high - low, 1.0)
    low, high = low - pad, high + pad

    def px(x: float) -> float:
        return LEFT + (x - low) / (high - low) * (WIDTH - LEFT - RIGHT)

    def py(y: float) -> float:
        return HEIGHT - BOTTOM - (y - low) / (high - low) * (HEIGHT - TOP - BOTTOM)

    parts = _frame(title, x_label, y_label)
    for tick in ticks(low, high):
        parts.append(f"<line class=grid x1={px(tick):.1f} x2={px(tick):.1f} y1={TOP} y2={HEIGHT - BOTTOM} />")
        parts.append(f"<line class=grid x1={LEFT} x2={WIDTH - RIGHT} y1={py(tick):.1f} y2={py(tick):.1f} />")
        parts.append(f"<text x={px(tick):.1f} y={HEIGHT - BOTTOM + 14} text-anchor=middle>{tick:g}</text>")
        parts.append(f"<text x={LEFT - 5} y={py(tick) + 4:.1f} text-anchor=end>{tick:g}</text>")
    parts.append(
        f"<line class=axis stroke-dasharray='4 3' x1={px(low):.1f} y1={py(low):.1f} "
        f"x2={px(high):.1f} y2={py(high):.1f} />"
    )
    for i, (name, dots) in enumerate(zip(points, known, strict=True)):
        colour = SERIES[i % len(SERIES)]
        parts += [
            f"<circle cx={px(x):.1f} cy={py(y):.1f} r=4 fill='{colour}' fill-opacity=.75><title>{escape(name)}: "
            f"{x:.1f}, {y:.1f}</title></circle>"
            for x, y in dots.T
        ]
        if len(points) > 1:
            parts.append(f"<circle cx={LEFT + 10} cy={TOP + 10 + 15 * i} r=4 fill='{colour}' />")
            parts.append(f"<text x={LEFT + 19} y={TOP + 14 + 15 * i}>{escape(name)}</text>")
    return _svg(parts, WIDTH, HEIGHT, title)


def bars(
    names: Sequence[str],
    values: Sequence[float],
    upper: Sequence[float],
    title: str,
    x_label: str,
    limits: Sequence[float] = (),
) -> str:
    """A horizontal bar a name, a thin line on to its upper value, and vertical lines at limits."""
    shown = [v for v in (*values, *upper, *limits) if math.isfinite(v)]
    if not shown:
        return f"<p class=quiet>{escape(title)}: not measured.</p>"
    high = 1.05 * max(shown) or 1.0
    width, row, left = 440, 20, 54
    height = TOP + row * len(names) + BOTTOM

    def px(x: float) -> float:
        return left + x / high * (width - left - RIGHT)

    parts = [f"<text x={left} y=14 font-weight=600>{escape(title)}</text>"]
    bottom = height - BOTTOM
    for tick in ticks(0.0, high):
        parts.append(f"<line class=grid x1={px(tick):.1f} x2={px(tick):.1f} y1={TOP} y2={bottom} />")
        parts.append(f"<text x={px(tick):.1f} y={bottom + 14} text-anchor=middle>{tick:g}</text>")
    for i, (name, value, end) in enumerate(zip(names, values, upper, strict=True)):
        middle = TOP + row * (i + 0.5)
        parts.append(f"<text x={left - 6} y={middle + 4:.1f} text-anchor=end>{escape(name)}</text>")
        if math.isfinite(end):
            parts.append(
                f"<line x1={px(0):.1f} x2={px(end):.1f} y1={middle:.1f} y2={middle:.1f} "
                f"stroke='{SERIES[0]}' stroke-opacity=.5 />"
            )
        if math.isfinite(value):
            parts.append(
                f"<rect x={px(0):.1f} y={middle - 6:.1f} width={px(value) - px(0):.1f} height=12 fill='{SERIES[0]}'>"
                f"<title>{escape(name)}: {value:.3g}</title></rect>"
            )
    parts += [
        f"<line class=axis stroke-dasharray='4 3' x1={px(x):.1f} x2={px(x):.1f} y1={TOP} y2={bottom} />"
        for x in limits
        if x <= high
    ]
    parts.append(f"<text x={(left + width) / 2:.0f} y={height - 8} text-anchor=middle>{escape(x_label)}</text>")
    return _svg(parts, width, height, title)


def _frame(title: str, x_label: str, y_label: str) -> list[str]:
    middle = (TOP + HEIGHT - BOTTOM) / 2
    return [
        f"<text x={LEFT} y=14 font-weight=600>{escape(title)}</text>",
        f"<text x={(LEFT + WIDTH) / 2:.0f} y={HEIGHT - 8} text-anchor=middle>{escape(x_label)}</text>",
        f"<text transform='translate(12 {middle:.0f}) rotate(-90)' text-anchor=middle>{escape(y_label)}</text>",
        f"<rect class=axis fill=none x={LEFT} y={TOP} width={WIDTH - LEFT - RIGHT} height={HEIGHT - TOP - BOTTOM} />",
    ]


def _svg(parts: list[str], width: int, height: int, title: str) -> str:
    return (
        f"<svg role=img aria-label='{escape(title, quote=True)}' viewBox='0 0 {width} {height}' "
        f"style='max-width:{width * 1.25:.0f}px'>{''.join(parts)}</svg>"
    )
