"""Plots place what they are given where it belongs."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import numpy as np
import pytest

from gazenerf.viz.report.blocks import Bars, Gallery, Page, Scatter, Text
from gazenerf.viz.report.page import render
from gazenerf.viz.report.plots import bars, scatter, ticks


def drawn(*plots: Scatter | Bars) -> list[ET.Element]:
    """The SVGs of a page that shows some plots."""
    text = render(Page("t", "q", "a", "Yes.", "pass", opening=(Gallery(plots),)))
    return [ET.fromstring(part.split("</svg>")[0] + "</svg>") for part in text.split("<figure>")[1:]]


def test_ticks_are_round_and_inside():
    assert ticks(-1.0, 11.0) == pytest.approx([0, 5, 10])
    assert ticks(0.0, 0.9) == pytest.approx([0, 0.2, 0.4, 0.6, 0.8])


def test_equal_pairs_lie_on_the_line_and_unknown_ones_are_left_out():
    values = np.array([-10.0, 0.0, 10.0, np.nan])
    plot = scatter({"same": (values, values), "half<": (values, 0.5 * values)}, "a & b", "x", "y")
    assert isinstance(plot, Scatter)
    root = drawn(plot)[0]
    assert root.get("aria-label") == "a & b"
    line = next(item for item in root.iter("line") if "dashed" in item.get("class", ""))
    x1, y1, x2, y2 = (float(line.get(key, "nan")) for key in ("x1", "y1", "x2", "y2"))
    dots = [dot for dot in root.iter("circle") if len(dot)]
    assert len(dots) == 6, "NaN is not drawn"
    off = [float(d.get("cy", "nan")) - (y1 + (float(d.get("cx", "nan")) - x1) * (y2 - y1) / (x2 - x1)) for d in dots]
    assert np.allclose(off[:3], 0.0, atol=0.2)
    assert off[3] < -5.0 and abs(off[4]) < 0.2 and off[5] > 5.0, "half of -10 lies above the line, half of 10 below"
    nothing = scatter({"none": (values[3:], values[3:])}, "a", "x", "y")
    assert isinstance(nothing, Text) and "not measured" in nothing.text


def test_bars_are_as_long_as_their_values_and_their_threshold_is_where_it_belongs():
    plot = bars(["a", "b", "c"], [1.0, 2.0, float("nan")], "t", "mm", 3.0)
    assert isinstance(plot, Bars)
    root = drawn(plot)[0]
    widths = [float(r.get("width", "nan")) for r in root.iter("rect")]
    assert widths[1] == pytest.approx(2 * widths[0], abs=0.2) and widths[2] == 0.0
    limit = next(item for item in root.iter("line") if "dashed" in item.get("class", ""))
    left = float(next(root.iter("rect")).get("x", "nan"))
    assert float(limit.get("x1", "nan")) - left == pytest.approx(3 * widths[0], abs=0.4)
    assert "passes up to 3" in [text.text for text in root.iter("text")]
    nothing = bars(["a"], [float("nan")], "t", "mm")
    assert isinstance(nothing, Text) and "not measured" in nothing.text
    free = bars(["a"], [1.0], "t", "mm")
    assert isinstance(free, Bars) and free.limit is None
