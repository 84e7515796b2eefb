"""A check as one self-contained page and one JSON file."""

from __future__ import annotations

import base64
import html
import io
import json
import math
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from itertools import groupby
from pathlib import Path

import numpy as np
from PIL import Image

from gazenerf import __version__
from gazenerf.files import whole_folder
from viz.check import CheckedView, CheckResult, Metric
from viz.colormaps import colour_depth, colour_normals, to_uint8
from viz.heatmaps import LIMIT_MM, colour_bar, depth_difference_picture, silhouette_picture

REPORT, NUMBERS = "report.html", "report.json"
DEPTH_REACH = 1.3
"""World units in front of the origin, seen from the camera, of the brightest depth colour."""

VERDICTS = {"pass": "passed", "warn": "to watch", "fail": "failed", "unmeasured": "not measured"}
"""Verdict to how the page's first line says it."""

PACKAGES = ("torch", "mitsuba", "pyrender", "open3d", "numpy")

_STYLE = """
:root{color-scheme:light dark}
body{font:16px/1.5 system-ui,sans-serif;max-width:72rem;margin:0 auto;padding:1rem;
  background:Canvas;color:CanvasText}
h1{font-size:1.5rem;line-height:1.25;margin:.2rem 0 .6rem}h2{font-size:1.2rem;margin:2rem 0 .5rem}
h3{font-size:1rem;margin:1.4rem 0 .2rem}
p{margin:.3rem 0}.quiet{opacity:.75;font-size:.9rem}code{font-size:.82rem;opacity:.75}
.scroll{overflow-x:auto}table{border-collapse:collapse;width:100%;font-size:.95rem}
th,td{text-align:left;padding:.4rem .6rem;border-bottom:1px solid #8884;vertical-align:top}
td code{display:block}th{font-weight:600}.g th{padding-top:1rem;border-bottom-width:2px}
.n{text-align:right;font-variant-numeric:tabular-nums;white-space:nowrap}
.v{display:inline-block;min-width:3.4rem;text-align:center;padding:.05rem .5rem;border-radius:1rem;color:#fff;
  font-size:.85rem;print-color-adjust:exact;-webkit-print-color-adjust:exact}
.pass{background:#1a7f37}.warn{background:#9a6700}.fail{background:#b42318}.unmeasured{background:#666}
.tiles{display:grid;grid-template-columns:repeat(4,1fr);gap:.6rem}
figure{margin:0}figure img{width:100%;display:block;border-radius:.3rem}
figcaption{font-size:.8rem;line-height:1.3;opacity:.85;margin-top:.2rem}
.key{display:flex;align-items:center;gap:.5rem;font-size:.85rem;margin:.3rem 0;flex-wrap:wrap}
.key img{width:14rem;height:.8rem;border-radius:.2rem}
@media(max-width:44rem){.tiles{grid-template-columns:repeat(2,1fr)}body{padding:.7rem}
  th,td{padding:.35rem .3rem}table{font-size:.88rem}.wide{display:none}td code{overflow-wrap:anywhere;font-size:.75rem}}
@media print{body{max-width:none;font-size:11pt}section,tr{break-inside:avoid}
  .tiles{grid-template-columns:repeat(4,1fr)}}
"""


def write_report(result: CheckResult, out: str | Path) -> tuple[Path, Path]:
    """Write `report.html` and `report.json` to a folder; both appear or neither does."""
    out = Path(out)
    numbers = result.to_dict() | {
        "versions": {"gazenerf": __version__, **{name: _version(name) for name in PACKAGES}},
        "made": datetime.now(UTC).isoformat(timespec="seconds"),
    }
    page = render_page(result, numbers)
    with whole_folder(out) as folder:
        (folder / REPORT).write_text(page, encoding="utf-8")
        (folder / NUMBERS).write_text(json.dumps(numbers, indent=2) + "\n", encoding="utf-8")
    return out / REPORT, out / NUMBERS


def render_page(result: CheckResult, numbers: dict) -> str:
    """The page as text; every picture is inside it."""
    about = result.about
    pitch, yaw = about["gaze_pitch_yaw_degrees"]
    counts = {kind: sum(metric.verdict == kind for metric in result.metrics) for kind in VERDICTS}
    missing = "".join(
        f"<p>The reference renderer {html.escape(name)} could not start; {html.escape(fix)}.</p>"
        for name, fix in result.missing.items()
    )
    rows = "".join(
        f"<tr class=g><th colspan=5 scope=rowgroup>{html.escape(group)}</th></tr>" + "".join(map(_row, metrics))
        for group, metrics in groupby(result.metrics, key=lambda metric: metric.group)
    )
    views = "".join(_view(view, result.about["metres_per_unit"]) for view in result.views)
    between = "".join(
        f"<tr><td>{html.escape(view)}</td><td>{html.escape(a)}, {html.escape(b)}</td>"
        f"<td class=n>{_number(r.depth_median_mm, 'mm', 4)}</td><td class=n>{_number(r.depth_p95_mm, 'mm', 4)}</td>"
        f"<td class=n>{_number(r.silhouette_px, 'px')}</td><td class=n>{_number(r.normal_median_deg, 'deg')}</td></tr>"
        for a, b, view, r in result.between
    )
    apart = (
        "<div class=scroll><table><tr><th>view</th><th>renderers</th><th class=n>depth, median</th>"
        "<th class=n>depth, 95 %</th><th class=n>silhouette</th><th class=n>normals</th></tr>"
        f"{between}</table></div>"
        if between
        else "<p>Only one renderer served, so there is nothing to compare it with.</p>"
    )
    pairs = "".join(
        f"<tr><td>{html.escape(a)} to {html.escape(b)}</td><td class=n>{_number(r.consistent, '')}</td>"
        f"<td class=n>{_number(r.round_trip_px, 'px')}</td><td class=n>{_number(r.depth_mm, 'mm')}</td>"
        f"<td class=n>{_number(r.warp_psnr, 'dB')}</td></tr>"
        for a, b, r in result.pairs
    )
    versions = ", ".join(f"{name} {number}" for name, number in numbers.get("versions", {}).items())
    return f"""<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width,initial-scale=1">
<title>Consistency of {html.escape(about["subject"])}</title><style>{_STYLE}</style></head><body>
<h1>Is {html.escape(about["subject"])} one consistent 3D head?</h1>
<p>{", ".join(f"{count} {VERDICTS[kind]}" for kind, count in counts.items() if count)}.
Gaze: pitch {pitch:g}&deg;, yaw {yaw:g}&deg;.
Reference: {html.escape(" and ".join(result.renderers))} renders of the head model at the same gaze.</p>{missing}
<h2>Verdict</h2><div class=scroll><table>
<tr><th>measure</th><th class=n>value</th><th>verdict</th><th class=n>passes</th><th class="n wide">warns</th></tr>
{rows}</table></div>{_size_note(result.surfaces.get("scale_percent", math.nan))}
<h2>Views, worst first</h2>
<div class=key>depth difference: -{LIMIT_MM:g} mm, field nearer
<img alt="colours from blue to red" src="{_inline(colour_bar())}">
+{LIMIT_MM:g} mm, field farther</div>
<p class=quiet>Depth: brighter is nearer. Normals: red right, green up, blue toward the camera.
Silhouettes: red only the field, blue only the reference.</p>{views}
<h2>Views against each other</h2>
<p class=quiet>Every pixel of one view carried by its depth into a neighbour and back.</p>
<div class=scroll><table>
<tr><th>from, to (yaw/pitch)</th><th class=n>consistent</th><th class=n>round trip</th><th class=n>depth</th>
<th class=n>warped picture</th></tr>{pairs}</table></div>
<h2>Reference renderers against each other</h2>{apart}
<p class=quiet>Depth is compared along each pixel's ray, one pixel inside the common silhouette. Nothing is aligned,
the Chamfer distance after a rigid fit apart.
Weights {html.escape(str(about["weights_sha256_16"]))}, codes {html.escape(str(about["codes_sha256_16"]))},
{about["views"]} views of {about["size_px"]} px,
definitions {html.escape(numbers["definitions"])}. {html.escape(versions)}.</p></body></html>
"""


def _size_note(percent: float) -> str:
    """Which way the sizes differ; nothing when they were not measured."""
    if not math.isfinite(percent):
        return ""
    return (
        f"<p class=quiet>By a similarity fit the field is {abs(percent):.2f} % "
        f"{'larger' if percent > 0 else 'smaller'} than the reference. Surfaces are compared where views show them.</p>"
    )


def _row(metric: Metric) -> str:
    sign = "&ge;" if metric.higher_is_better else "&le;"
    return (
        f"<tr><td>{html.escape(metric.label)}<code>{html.escape(metric.name)}</code></td>"
        f"<td class=n>{_number(metric.value, metric.unit)}</td>"
        f"<td><span class='v {metric.verdict}'>{metric.verdict}</span></td>"
        f"<td class=n>{sign} {metric.passes:g}</td><td class='n wide'>{sign} {metric.warns:g}</td></tr>"
    )


def _view(view: CheckedView, scale: float) -> str:
    agreement = view.agreement
    reference = view.reference
    assert view.geometry.normals is not None
    camera = view.geometry.camera
    middle = float(np.linalg.norm(camera.position))
    near, far = middle - DEPTH_REACH, middle + 0.3 * DEPTH_REACH
    mine, theirs = (np.isfinite(depth).astype(np.float32) for depth in (view.geometry.depth, reference.depth))
    tiles = (
        ("field: picture", view.image),
        *([] if reference.colour is None else [(f"reference: picture, {reference.renderer}", reference.colour)]),
        ("field: depth", colour_depth(view.geometry.depth, mine, near, far)),
        ("reference: depth", colour_depth(reference.depth, theirs, near, far)),
        ("depth difference: blue nearer, red farther", depth_difference_picture(view.geometry, reference, scale)),
        ("field: normals", colour_normals(view.geometry.normals, mine, camera)),
        ("reference: normals", colour_normals(reference.normals, theirs, camera)),
        ("silhouettes: red only field, blue only reference", silhouette_picture(view.geometry, reference, view.image)),
    )
    figures = "".join(
        f"<figure><img alt='{html.escape(name)}' src='{_inline(picture)}'>"
        f"<figcaption>{html.escape(name)}</figcaption></figure>"
        for name, picture in tiles
    )
    return (
        f"<section><h3>yaw {view.yaw:+.0f}&deg;, pitch {view.pitch:+.0f}&deg;</h3>"
        f"<p class=quiet>depth {_number(agreement.depth_median_mm, 'mm')} median, "
        f"{_number(agreement.depth_p95_mm, 'mm')} at 95 %, bias {_number(agreement.depth_bias_mm, 'mm')}; "
        f"overlap {_number(agreement.silhouette_iou, '')}; normals {_number(agreement.normal_median_deg, 'deg')}</p>"
        f"<div class=tiles>{figures}</div></section>"
    )


def _number(value: float, unit: str, digits: int | None = None) -> str:
    if not math.isfinite(value):
        return "not measured"
    if abs(value) >= 1000.0:
        return f"{value:,.0f} {unit}".strip()
    digits = digits or (3 if abs(value) < 1 or not unit else 2)
    return f"{value:.{digits}f} {unit}".strip()


def _inline(picture: np.ndarray) -> str:
    buffer = io.BytesIO()
    Image.fromarray(to_uint8(picture)).save(buffer, format="png", optimize=True)
    return "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode()


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "absent"
