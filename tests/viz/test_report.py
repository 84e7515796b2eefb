"""The report page from made-up results: what a reader sees, and that nothing is fetched."""

from __future__ import annotations

import html
import json
import math
import re
from dataclasses import replace

import numpy as np
import pytest

from gazenerf.field.analytic import AnalyticField
from gazenerf.geometry import Camera
from viz.agreement import compare
from viz.check import GAUGES, CheckedView, CheckResult
from viz.heatmaps import FARTHER, NEARER, colour_bar, silhouette_picture
from viz.reference import ReferenceView
from viz.report import write_report

SIZE = 40


def checked(offset_z: float, yaw: float) -> CheckedView:
    """An analytic view against the analytic head moved along the view."""
    camera = Camera.orbit(np.deg2rad(yaw), 0.0, size=SIZE)
    truth = AnalyticField()
    found = AnalyticField(face_offset=(0.0, 0.0, offset_z)).render_geometry(camera, "head", normals=True)
    exact = truth.render_geometry(camera, "head", normals=True)
    assert exact.normals is not None
    parts = np.isfinite(exact.depth).astype(np.uint8)
    reference = ReferenceView(camera, exact.depth, exact.normals, parts, "exact", truth.render(camera).image)
    agreement = compare(found, reference, 0.1)
    return CheckedView(yaw, 0.0, truth.render(camera).image, found, reference, agreement, {"second": agreement})


@pytest.fixture(scope="module")
def result() -> CheckResult:
    values = dict.fromkeys((gauge.name for gauge in GAUGES), math.nan) | {"depth_median_mm": 2.0, "warp_psnr": 10.0}
    about = {
        "subject": "<b>someone</b>",
        "gaze_pitch_yaw_degrees": [0.0, 10.0],
        "weights_sha256_16": "w" * 16,
        "codes_sha256_16": "c" * 16,
        "size_px": SIZE,
        "views": 2,
        "metres_per_unit": 0.1,
    }
    views = (checked(0.05, 20.0), checked(0.0, 0.0))
    between = (("exact", "second", "+0/+0", views[1].agreement),)
    return CheckResult(
        tuple(replace(gauge, value=values[gauge.name]) for gauge in GAUGES),
        views, (), ("exact", "second"), {"third": "no driver; install one"}, about, between,
        {"scale_percent": -1.5},
    )  # fmt: skip


def test_the_page_says_verdict_views_and_missing_renderers(result, tmp_path):
    page, _ = write_report(result, tmp_path)
    text = page.read_text()
    assert text.index("Verdict") < text.index("Views, worst first") < text.index("yaw +20") < text.index("yaw +0")
    assert "2.00 mm" in text and text.count("class='v warn'") == 1 and text.count("class='v fail'") == 1
    assert f"<p>1 to watch, 1 failed, {len(GAUGES) - 2} not measured." in text
    assert text.count("class='v unmeasured'") == len(GAUGES) - 2 and "not measured" in text
    groups = list(dict.fromkeys(gauge.group for gauge in GAUGES))
    headings = re.findall(r"scope=rowgroup>([^<]+)<", text)
    assert [html.unescape(heading) for heading in headings] == groups
    assert "the field is 1.50 % smaller than the reference" in text
    assert "third could not start; no driver; install one" in text
    assert "reference: picture, exact" in text
    assert "&lt;b&gt;someone" in text and "<b>someone" not in text
    assert not re.search(r"https?:|url\(|<script|<link|@import", text)
    assert "color-scheme:light dark" in text and 'name="viewport"' in text


def test_the_numbers_hold_every_comparison_and_no_nan(result, tmp_path):
    _, numbers = write_report(result, tmp_path)
    data = json.loads(numbers.read_text(), parse_constant=lambda name: pytest.fail(f"{name} is no JSON"))
    assert [metric["name"] for metric in data["metrics"]] == [gauge.name for gauge in GAUGES]
    assert all({"unit", "value", "passes", "warns", "verdict"} <= set(metric) for metric in data["metrics"])
    assert data["surfaces"] == {"scale_percent": -1.5}
    first = data["views"][0]
    assert first["reference"] == "exact" and first["others"]["second"]["depth_median_mm"] == first["depth_median_mm"]
    assert data["between_renderers"][0]["b"] == "second"
    assert data["missing_renderers"] == {"third": "no driver; install one"}


def test_a_nearer_field_is_blue_and_disputed_pixels_are_marked(result):
    view = result.views[0]
    assert (colour_bar()[0, 0] == NEARER).all() and (colour_bar()[0, -1] == FARTHER).all()
    gone = replace(view.geometry, depth=np.full_like(view.geometry.depth, np.nan))
    missing = silhouette_picture(gone, view.reference, view.image)
    assert (missing[view.reference.parts > 0] == NEARER).all()
    extra = silhouette_picture(view.geometry, gone, view.image)
    assert (extra[np.isfinite(view.geometry.depth)] == FARTHER).all()
