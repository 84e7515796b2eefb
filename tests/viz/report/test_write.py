"""The report page from made-up results: what a reader sees, and that nothing is fetched."""

from __future__ import annotations

import html
import json
import math
import re
from dataclasses import replace

import numpy as np
import pytest

from gazenerf.geometry import Camera
from gazenerf.heads.analytic import AnalyticField
from gazenerf.viz.check.result import CheckedView, CheckResult
from gazenerf.viz.metrics.agreement import compare
from gazenerf.viz.metrics.colmap import StructureFromMotion
from gazenerf.viz.metrics.drift import Drift, TextureFollow, ViewDrift
from gazenerf.viz.metrics.eyes import EyeSweep
from gazenerf.viz.metrics.families import CHECK_DEFINITIONS as DEFINITIONS
from gazenerf.viz.metrics.families import measured
from gazenerf.viz.metrics.orbit_pictures import OrbitPictures
from gazenerf.viz.metrics.pairs import PairReading
from gazenerf.viz.metrics.reprojection import Reprojection
from gazenerf.viz.metrics.tsed import PairMatches, Tsed
from gazenerf.viz.pictures.surface_colours import FARTHER, NEARER, colour_bar
from gazenerf.viz.reference.views import ReferenceView
from gazenerf.viz.report.error_mesh import FILE, error_mesh
from gazenerf.viz.report.heatmaps import silhouette_picture
from gazenerf.viz.report.write import write_report
from gazenerf.viz.selftest.faults import scene_mesh

SIZE = 40
UNKNOWN = len(DEFINITIONS) - 2
"""Metrics without a value in the result below."""


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
    values = {"depth_median_mm": (2.0, math.nan), "warp_psnr": (10.0, math.nan)}
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
        measured(DEFINITIONS, values),
        views, (), ("exact", "second"), {"third": "no driver; install one"}, about, between,
        {"scale_percent": -1.5},
    )  # fmt: skip


def matches(a: int, b: int, distances: np.ndarray) -> PairMatches:
    """Two pictures with matched features so far from their epipolar lines."""
    points = np.zeros((len(distances), 2))
    return PairMatches(a, b, points, points, distances)


@pytest.fixture(scope="module")
def whole(result) -> CheckResult:
    """With everything that a check can hold."""
    rng = np.random.default_rng(0)
    commanded = np.array([[0.0, 10.0], [10.0, 0.0], [-10.0, -20.0]])
    sweep = EyeSweep(
        commanded=commanded,
        measured={"left": commanded * 0.9, "right": np.full((3, 2), np.nan)},
        spread_deg={"left": np.ones(3), "right": np.full(3, np.nan)},
        centres={eye: np.zeros((3, 3)) for eye in ("left", "right")},
        radii_mm={eye: np.full(3, 12.0) for eye in ("left", "right")},
        reference_centres=np.zeros((2, 3)),
        reference_radius_mm=12.0,
        response=np.eye(2),
        bias_deg=np.array([0.5, -1.0]),
        nonlinear_deg=0.7,
        pose_change_mm=np.array([0.0, 0.1, 0.2]),
        pose_change_deg=np.zeros(3),
        face_change_psnr=np.array([np.nan, 40.0, 41.0]),
        pictures=rng.uniform(size=(3, 12, 40, 3)),
    )
    good, bad = Reprojection(0.99, 0.1, 0.2, 31.0, 500, 0.02, 0.97), Reprojection(0.9, 0.4, 0.2, 21.0, 500, 0.09, 0.9)
    streams = {
        "head": (PairReading("+0/+0", "+5/+0", 5.0, "short", good, bad),),
        "eyes": (
            PairReading("+0/+0", "+5/+0", 5.0, "short", good, good),
            PairReading("a", "b", 5.0, "short", bad, bad),
        ),
    }
    drift = Drift((ViewDrift("+0/+0", 0.98, (0.1, -0.2), (np.nan, np.nan), 0.6),),
                  (TextureFollow("+0/+0", "+5/+0", 0.3, 0.05, 900),), 8.0)  # fmt: skip
    orbit = OrbitPictures(
        ("-5/+5", "+0/+5", "+5/+5"),
        Tsed((matches(0, 1, np.full(22, 0.4)), matches(1, 2, np.zeros(0)))),
        StructureFromMotion(pictures=13, registered=12, points=99, reprojection_px=0.5, position_percent=0.4,
                            turn_deg=0.3, reason=""),
    )  # fmt: skip
    return replace(
        result, streams=streams, drift=drift, eyes=sweep, strips={"eyes": rng.uniform(size=(6, SIZE, 3))},
        strip_degrees=(-20.0, 20.0), notes=("LPIPS was <left> out.",),
        orbit=orbit,
    )  # fmt: skip


def marked(text: str) -> str:
    """The page without what its pictures hold."""
    return re.sub(r"base64,[A-Za-z0-9+/=]+", "base64,", text)


def shown(text: str) -> str:
    """What a reader sees: no style, no script, no tags, single spaces."""
    body = re.sub(r"<(style|script)>.*?</\1>", "", marked(text), flags=re.DOTALL)
    return re.sub(r"\s+", " ", html.unescape(re.sub(r"<[^>]+>", " ", body)))


def test_the_page_says_verdict_views_and_missing_renderers(result, tmp_path):
    page, _ = write_report(result, tmp_path)
    text = page.read_text()
    places = ("Every metric</h2>", "Views, worst first</h2>", "<h3>yaw +20°", "<h3>yaw +0°")
    order = [text.index(said) for said in places]
    assert order == sorted(order)
    said = shown(text)
    assert "depth_median_mm" in said and "2.00 mm" in said
    verdicts = re.findall(r'<span class="v (\w+)">(\w[^<]*)</span>', text)
    assert verdicts.count(("warn", "warn")) == verdicts.count(("fail", "fail")) == 2, "once in its family, once above"
    for kind, count, word in (("warn", 1, "warn"), ("fail", 1, "fail"), ("unmeasured", UNKNOWN, "not measured")):
        assert (kind, f"{count} {word}") in verdicts
    groups = list(dict.fromkeys(definition.group for definition in DEFINITIONS))
    headings = re.findall(r'<summary><span class="name">([^<]+)<', text)
    assert [html.unescape(heading) for heading in headings] == groups
    assert text.count('<td class="n">not measured') == UNKNOWN
    assert "the field is 1.50 % smaller than the reference" in said
    assert "third could not start; no driver; install one" in said
    assert "Right: the reference head, drawn by exact" in said
    assert "&lt;b&gt;someone" in text and "<b>someone" not in text


def test_one_sentence_answers_the_title_before_any_picture(result, tmp_path):
    text = write_report(result, tmp_path)[0].read_text()
    found = re.findall(r'<p class="answer (\w+)">([^<]+)</p>', text)
    assert [tone for tone, _ in found] == ["fail"]
    sentence = html.unescape(found[0][1])
    assert sentence.startswith("No: its views contradict each other") and sentence.count(".") == 1
    assert "its surface is a little off the reference head" in sentence
    assert text.index("</h1>") < text.index('class="answer') < text.index("<img") < text.index("<nav")


def test_the_page_opens_with_the_orbit_and_the_worst_view_over_its_reference(result, tmp_path):
    text = write_report(result, tmp_path)[0].read_text()
    opening = text[text.index("</header>") : text.index("<nav")]
    assert re.findall(r"<figcaption>(yaw [+-]\d+°), pitch", opening) == ["yaw +0°", "yaw +20°"], "in the order of yaw"
    assert opening.count("<input") == 1 and "yaw +20°, pitch +0°" in opening


def test_what_warns_or_fails_is_explained_and_advised_failures_first(result, tmp_path):
    text = write_report(result, tmp_path)[0].read_text()
    part = text[text.index('<section id="what-needs-attention">') :]
    part = part[: part.index("</section>")]
    assert re.findall(r'<li class="(\w+)">', part) == ["fail", "warn"]
    for name in ("warp_psnr", "depth_median_mm"):
        definition = next(d for d in DEFINITIONS if d.name == name)
        assert definition.meaning and definition.meaning in shown(part), name
        assert definition.advice and definition.advice in shown(part), name
    assert "10.0 dB, passes ≥ 30" in shown(part)


def test_every_metric_has_its_meaning_in_place_and_families_that_pass_are_folded(whole, tmp_path):
    text = write_report(whole, tmp_path)[0].read_text()
    said = shown(text)
    for definition in DEFINITIONS:
        assert definition.meaning and definition.meaning in said, definition.name
    families = re.findall(r'<details class="family"( open)?>\s*<summary><span class="name">([^<]+)<', text)
    beyond = {metric.definition.group for metric in whole.metrics if metric.verdict in ("warn", "fail")}
    assert {html.unescape(name) for opened, name in families if opened} == beyond and len(families) > len(beyond)


def test_the_table_of_contents_leads_to_every_section(whole, tmp_path):
    text = write_report(whole, tmp_path)[0].read_text()
    links, targets = re.findall(r'<a href="#([^"]+)">', text), re.findall(r'<section id="([^"]+)">', text)
    assert links == targets and len(set(targets)) == len(targets) > 8


def test_a_bar_is_drawn_against_the_threshold_that_holds_for_it(result, tmp_path):
    text = write_report(result, tmp_path)[0].read_text()
    plots = {
        title: float(limit)
        for title, limit in re.findall(r'aria-label="(Depth error[^"]*)".*?passes up to ([\d.]+)<', text, re.DOTALL)
    }
    limits = {definition.name: definition.passes for definition in DEFINITIONS}
    assert plots == {
        "Depth error of each view, median over its pixels": limits["depth_worst_mm"],
        "Depth error of each view, 95th percentile of its pixels": limits["depth_p95_mm"],
    }


def test_no_interval_of_a_share_leaves_its_range(result, tmp_path):
    metrics = tuple(
        replace(metric, value=0.99, error=0.2) if metric.name == "reprojection" else metric for metric in result.metrics
    )
    said = shown(write_report(replace(result, metrics=metrics), tmp_path)[0].read_text())
    assert "0.790 to 1.000" in said


def test_nothing_is_fetched_and_the_page_is_whole_without_scripts(whole, tmp_path):
    text = write_report(whole, tmp_path)[0].read_text()
    markup = marked(text)
    assert not re.search(r"https?:|url\(|<link|@import|src=[\"'](?!data:)|href=[\"'](?!#)", markup)
    assert markup.count("<script>") == 1 and markup.index("<script>") > markup.index("Provenance</h2>")
    assert re.search(r"color-scheme:\s*light dark", text) and 'name="viewport"' in text and "@media print" in text
    style = markup[: markup.index("</style>")]
    assert re.search(r"(?<!\.js )\.slide \{ display: grid", style), "without scripts the pictures stand side by side"
    assert markup.count('<input type="range"') == 3, "a slider a view, and the opening's"
    assert len(text) < 4_000_000


def test_the_page_shows_everything_that_was_measured(whole, tmp_path):
    text = shown(write_report(whole, tmp_path)[0].read_text())
    for said in (
        "yaw -20° (top) to +20°",
        "measured against commanded",
        "+9.0/+0.0",
        "not found",
        "half a feature pixel would be 4 px",
        "+0.10, -0.20",
        "LPIPS was <left> out",
        "COLMAP registered 12 of 13",
        "eyes stream alone",
    ):
        assert said in text, said
    assert "LPIPS was &lt;left&gt; out" in (tmp_path / "report.html").read_text()
    assert text.index("a from b, eyes stream") < text.index("+0/+0 from +5/+0, eyes stream"), "worst pair first"
    assert text.index("-5/+5 and +0/+5") > text.index("+0/+5 and +5/+5"), "unmatched pair first"


def test_the_error_mesh_is_written_beside_the_report_and_explained(result, tmp_path):
    field = AnalyticField(sharpness=0.2)
    error = error_mesh(field, scene_mesh(field, 3), resolution=48, threshold=100.0)
    page, numbers = write_report(result, tmp_path, error=error, bound=field)
    assert (tmp_path / FILE).is_file() and "Error mesh" in page.read_text()
    assert json.loads(numbers.read_text())["error_mesh"]["field"]["compared"] > 1000


def test_the_numbers_hold_every_comparison_and_no_nan(result, tmp_path):
    _, numbers = write_report(result, tmp_path)
    data = json.loads(numbers.read_text(), parse_constant=lambda name: pytest.fail(f"{name} is no JSON"))
    assert [metric["name"] for metric in data["metrics"]] == [definition.name for definition in DEFINITIONS]
    assert all({"unit", "value", "passes", "warns", "verdict"} <= set(metric) for metric in data["metrics"])
    assert {"gazenerf", "python", "pycolmap"} <= set(data["versions"]) and data["made"]
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
