"""Plots place what they are given where it belongs."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET

import numpy as np
import pytest

from gazenerf.viz.report.plots import bars, scatter, ticks


def parse(svg: str) -> ET.Element:
    """The SVG as a tree; attributes without quotes are given some."""
    return ET.fromstring(re.sub(r"=([\w.\-]+)(?=[\s/>])", r"='\1'", svg))


def test_ticks_are_round_and_inside():
    assert ticks(-1.0, 11.0) == pytest.approx([0, 5, 10])
    assert ticks(0.0, 0.9) == pytest.approx([0, 0.2, 0.4, 0.6, 0.8])


def test_equal_pairs_lie_on_the_line_and_unknown_ones_are_left_out():
    values = np.array([-10.0, 0.0, 10.0, np.nan])
    root = parse(scatter({"same": (values, values), "half<": (values, 0.5 * values)}, "a & b", "x", "y"))
    line = next(item for item in root.iter("line") if item.get("stroke-dasharray"))
    x1, y1, x2, y2 = (float(line.get(key, "nan")) for key in ("x1", "y1", "x2", "y2"))
    dots = [dot for dot in root.iter("circle") if len(dot)]
    assert len(dots) == 6, "NaN is not drawn"
    off = [float(d.get("cy", "nan")) - (y1 + (float(d.get("cx", "nan")) - x1) * (y2 - y1) / (x2 - x1)) for d in dots]
    assert np.allclose(off[:3], 0.0, atol=0.2)
    assert off[3] < -5.0 and abs(off[4]) < 0.2 and off[5] > 5.0, "half of -10 lies above the line, half of 10 below"
    assert "not measured" in scatter({"none": (values[3:], values[3:])}, "a", "x", "y")


def test_bars_are_as_long_as_their_values():
    root = parse(bars(["a", "b", "c"], [1.0, 2.0, float("nan")], [1.5, 4.0, float("nan")], "t", "mm", [3.0]))
    widths = [float(r.get("width", "nan")) for r in root.iter("rect")]
    assert len(widths) == 2 and widths[1] == pytest.approx(2 * widths[0], abs=0.2)
    ends = [line for line in root.iter("line") if line.get("stroke-opacity")]
    lengths = [float(line.get("x2", "nan")) - float(line.get("x1", "nan")) for line in ends]
    assert lengths == pytest.approx([1.5 * widths[0], 4.0 * widths[0]], abs=0.4)
    assert "not measured" in bars(["a"], [float("nan")], [float("nan")], "t", "mm")
