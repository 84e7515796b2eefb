"""A check as one self-contained page and one JSON file."""

from __future__ import annotations

import base64
import html
import io
import json
import math
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np
from PIL import Image

from gazenerf import __version__
from gazenerf.files import whole_folder
from viz.check import CheckedView, CheckResult, Metric
from viz.colormaps import colour_depth, colour_normals, to_uint8
from viz.heatmaps import depth_difference_picture, silhouette_picture

REPORT, NUMBERS = "report.html", "report.json"
DEPTH_REACH = 1.3
"""World units in front of the origin, seen from the camera, of the brightest depth colour."""

PACKAGES = ("torch", "mitsuba", "pyrender", "open3d", "numpy")

_STYLE = """
:root{color-scheme:light dark}
body{font:16px/1.5 system-ui,sans-serif;max-width:72rem;margin:0 auto;padding:1rem;
  background:Canvas;color:CanvasText}
h1{font-size:1.5rem;margin:.2rem 0}h2{font-size:1.15rem;margin:1.6rem 0 .4rem}
p{margin:.3rem 0}.quiet{opacity:.7;font-size:.9rem}
.scroll{overflow-x:auto}table{border-collapse:collapse;width:100%;font-size:.95rem}
th,td{text-align:left;padding:.35rem .6rem;border-bottom:1px solid color-mix(in srgb,CanvasText 18%,Canvas)}
td.n{text-align:right;font-variant-numeric:tabular-nums;white-space:nowrap}
.v{display:inline-block;padding:.05rem .55rem;border-radius:1rem;color:#fff;font-size:.85rem}
.pass{background:#1a7f37}.warn{background:#9a6700}.fail{background:#b42318}.unmeasured{background:#666}
.tiles{display:grid;grid-template-columns:repeat(auto-fill,minmax(150px,1fr));gap:.6rem}
figure{margin:0}figure img{width:100%;display:block;border-radius:.3rem}
figcaption{font-size:.8rem;opacity:.8;margin-top:.15rem}
@media print{body{max-width:none}section{break-inside:avoid}}
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
    counts = {kind: sum(metric.verdict == kind for metric in result.metrics) for kind in ("pass", "warn", "fail")}
    missing = "".join(
        f"<p>The reference renderer {html.escape(name)} could not start; {html.escape(fix)}.</p>"
        for name, fix in result.missing.items()
    )
    rows = "".join(_row(metric) for metric in result.metrics)
    views = "".join(_view(view, result.about["metres_per_unit"]) for view in result.views)
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
<p>{counts["pass"]} passed, {counts["warn"]} to watch, {counts["fail"]} failed.
Gaze: pitch {pitch:g}&deg;, yaw {yaw:g}&deg;.
Reference: {html.escape(" and ".join(result.renderers))} renders of the head model at the same gaze.</p>{missing}
<h2>Verdict</h2><div class=scroll><table>
<tr><th>measure</th><th>value</th><th>passes</th><th>warns</th><th></th></tr>{rows}</table></div>
<h2>Views, worst first</h2>{views}
<h2>Views against each other</h2><div class=scroll><table>
<tr><th>from, to (yaw/pitch)</th><th>consistent</th><th>round trip</th><th>depth</th><th>warped picture</th></tr>
{pairs}</table></div>
<p class=quiet>Depth is compared along each pixel's ray, one pixel inside the common silhouette, with no alignment.
Weights {html.escape(str(about["weights_sha256_16"]))}, {about["views"]} views of {about["size_px"]} px,
definitions {html.escape(numbers["definitions"])}. {html.escape(versions)}.</p></body></html>
"""


def _row(metric: Metric) -> str:
    sign = "&ge;" if metric.higher_is_better else "&le;"
    return (
        f"<tr><td>{html.escape(metric.label)}</td><td class=n>{_number(metric.value, metric.unit)}</td>"
        f"<td class=n>{sign} {metric.passes:g}</td><td class=n>{sign} {metric.warns:g}</td>"
        f"<td><span class='v {metric.verdict}'>{metric.verdict}</span></td></tr>"
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
        ("field: depth", colour_depth(view.geometry.depth, mine, near, far)),
        ("reference: depth", colour_depth(reference.depth, theirs, near, far)),
        ("difference, blue nearer", depth_difference_picture(view.geometry, reference, scale)),
        ("field: normals", colour_normals(view.geometry.normals, mine, camera)),
        ("reference: normals", colour_normals(reference.normals, theirs, camera)),
        ("silhouettes: red field, blue reference", silhouette_picture(view.geometry, reference)),
    )
    figures = "".join(
        f"<figure><img alt='{html.escape(name)}' src='{_inline(picture)}'>"
        f"<figcaption>{html.escape(name)}</figcaption></figure>"
        for name, picture in tiles
    )
    return (
        f"<section><h2>yaw {view.yaw:+.0f}&deg;, pitch {view.pitch:+.0f}&deg;</h2>"
        f"<p class=quiet>depth {_number(agreement.depth_median_mm, 'mm')} median, "
        f"{_number(agreement.depth_p95_mm, 'mm')} at 95 %, bias {_number(agreement.depth_bias_mm, 'mm')}; "
        f"overlap {_number(agreement.silhouette_iou, '')}; normals {_number(agreement.normal_median_deg, 'deg')}</p>"
        f"<div class=tiles>{figures}</div></section>"
    )


def _number(value: float, unit: str) -> str:
    if not math.isfinite(value):
        return "not measured"
    digits = 3 if abs(value) < 1 else 2
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
