"""A check as one self-contained page and one JSON file."""

from __future__ import annotations

import json
import math
import platform
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from gazenerf import __version__
from gazenerf.files import whole_folder
from gazenerf.heads.interface import BoundField
from gazenerf.viz.check.result import CheckedView, CheckResult, plain
from gazenerf.viz.pictures.colormaps import colour_depth, colour_normals
from gazenerf.viz.report.error_mesh import ErrorMesh, write_error_mesh
from gazenerf.viz.report.heatmaps import depth_difference_picture, silhouette_picture
from gazenerf.viz.report.page import (
    chart,
    counts,
    escape,
    figure,
    number,
    page,
    photograph,
    slider,
    tiles,
    verdict_table,
    worst_sentence,
)
from gazenerf.viz.report.plots import bars
from gazenerf.viz.report.sections import (
    drift_section,
    error_mesh_section,
    eyes_section,
    renderers_section,
    scalar_bar,
    streams_section,
    strips_section,
    tsed_section,
)

REPORT, NUMBERS = "report.html", "report.json"
DEPTH_REACH = 1.3
"""World units in front of the origin, seen from the camera, of the brightest depth colour."""

LIMIT_MM = 5.0
"""Depth differences beyond this take the end colours."""

FULL_VIEWS = 4
"""The worst views are shown with every map, the others with the most telling ones."""

PACKAGES = ("torch", "mitsuba", "pyrender", "open3d", "opencv-contrib-python-headless", "pycolmap", "numpy", "scipy")


def write_report(
    result: CheckResult, out: str | Path, *, error: ErrorMesh | None = None, bound: BoundField | None = None
) -> tuple[Path, Path]:
    """Write `report.html` and `report.json` to a folder, and `error.glb` where there is one; all appear or none does.

    Args:
        result: What `check_subject` found.
        out: Folder.
        error: Coloured surfaces of `bound`.
        bound: Needed with `error`.
    """
    out = Path(out)
    with whole_folder(out) as folder:
        facts = {}
        if error is not None and bound is not None:
            facts = {"error_mesh": plain(write_error_mesh(error, bound, folder))}
        numbers = result.to_dict() | facts | provenance()
        (folder / REPORT).write_text(render_page(result, numbers), encoding="utf-8")
        (folder / NUMBERS).write_text(json.dumps(numbers, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    return out / REPORT, out / NUMBERS


def provenance() -> dict[str, Any]:
    """Software versions and the time, for report.json."""
    versions = {"gazenerf": __version__, "python": platform.python_version()}
    return {
        "versions": versions | {name: _version(name) for name in PACKAGES},
        "made": datetime.now(UTC).isoformat(timespec="seconds"),
    }


def render_page(result: CheckResult, numbers: dict[str, Any]) -> str:
    """The page as text; every picture is inside it."""
    about = result.about
    pitch, yaw = about["gaze_pitch_yaw_degrees"]
    missing = "".join(
        f"<p>The reference renderer {escape(name)} could not start; {escape(fix)}.</p>"
        for name, fix in result.missing.items()
    )
    notes = "".join(f"<li>{escape(note)}</li>" for note in result.notes)
    sections = [
        f"<h1>Is {escape(about['subject'])} one consistent 3D head?</h1>"
        f"<p class=quiet>Gaze: pitch {pitch:g}&deg;, yaw {yaw:g}&deg;. Reference: "
        f"{escape(' and '.join(result.renderers))} renders of the head model at the same gaze.</p>",
        counts(result.metrics) + worst_sentence(result.metrics) + missing,
        f"<h2>Verdict</h2><p class=quiet>&plusmn; is half the 95 % interval over views, pairs and gazes.</p>"
        f"{verdict_table(result.metrics)}{_size_note(result.surfaces.get('scale_percent', math.nan))}",
        _views(result),
        strips_section(result),
        eyes_section(result),
        streams_section(result),
        drift_section(result),
        tsed_section(numbers),
        renderers_section(result),
        error_mesh_section(numbers.get("error_mesh")),
        f"<h2>What was left out</h2><ul>{notes}</ul>" if notes else "",
        footer(numbers, f"Weights {about['weights_sha256_16']}, codes {about['codes_sha256_16']}, "
               f"{about['views']} views of {about['size_px']} px, seed {about.get('seed', 0)}"),
    ]  # fmt: skip
    return page(f"Consistency of {about['subject']}", "\n".join(part for part in sections if part))


def footer(numbers: dict[str, Any], about: str) -> str:
    """What a page was made from and by."""
    versions = ", ".join(f"{name} {value}" for name, value in numbers.get("versions", {}).items())
    return (
        f"<h2>Provenance</h2><p class=quiet>{escape(about)}. Definitions {escape(str(numbers['definitions']))}. "
        f"Made {escape(str(numbers.get('made', '')))} by {escape(versions)}.</p>"
    )


def _size_note(percent: float) -> str:
    """Which way the sizes differ; nothing when they were not measured."""
    if not math.isfinite(percent):
        return ""
    return (
        f"<p class=quiet>By a similarity fit the field is {abs(percent):.2f} % "
        f"{'larger' if percent > 0 else 'smaller'} than the reference. Surfaces are compared where views show them.</p>"
    )


def _views(result: CheckResult) -> str:
    if not result.views:
        return ""
    scale = result.about["metres_per_unit"]
    plot = bars(
        [view.name for view in result.views],
        [view.agreement.depth_median_mm for view in result.views],
        [view.agreement.depth_p95_mm for view in result.views],
        "Depth error: median (bar), 95 % (line), passes (dashed)",
        "mm",
        [result.metric("depth_median_mm").passes],
    )
    key = scalar_bar(f"−{LIMIT_MM:g} mm, field nearer", f"+{LIMIT_MM:g} mm, field farther")
    shown = "".join(_view(view, scale, full=i < FULL_VIEWS) for i, view in enumerate(result.views))
    return (
        f"<h2>Views, worst first</h2><figure>{plot}</figure>{key}"
        "<p class=quiet>Views are named yaw/pitch. Depth: brighter is nearer. Normals: red right, green up, blue "
        f"toward the camera. Silhouettes: red only the field, blue only the reference.</p>{shown}"
    )


def _view(view: CheckedView, scale: float, full: bool) -> str:
    agreement, reference, camera = view.agreement, view.reference, view.geometry.camera
    middle = float(np.linalg.norm(camera.position))
    near, far = middle - DEPTH_REACH, middle + 0.3 * DEPTH_REACH
    mine, theirs = (np.isfinite(depth).astype(np.float32) for depth in (view.geometry.depth, reference.depth))
    photo = photograph(view.image)
    difference = chart(depth_difference_picture(view.geometry, reference, scale, LIMIT_MM))
    outlines = photograph(silhouette_picture(view.geometry, reference, view.image))
    other = None if reference.colour is None else photograph(reference.colour)
    pictures = [figure(photo, "field: picture")]
    if other is not None and full:
        pictures = [slider(photo, other, f"left the field, right the reference ({reference.renderer})")]
    elif other is not None:
        pictures += [figure(other, f"reference: picture, {reference.renderer}")]
    pictures += [figure(difference, "depth difference: blue nearer, red farther")]
    pictures += [figure(outlines, "silhouettes: red only field, blue only reference")]
    maps = []
    if full:
        maps += [figure(chart(colour_depth(view.geometry.depth, mine, near, far)), "field: depth")]
        maps += [figure(chart(colour_depth(reference.depth, theirs, near, far)), "reference: depth")]
    if full and view.geometry.normals is not None:
        maps += [figure(photograph(colour_normals(view.geometry.normals, mine, camera)), "field: normals")]
        maps += [figure(photograph(colour_normals(reference.normals, theirs, camera)), "reference: normals")]
    return (
        f"<section><h3>yaw {view.yaw:+.0f}&deg;, pitch {view.pitch:+.0f}&deg;</h3>"
        f"<p class=quiet>depth {number(agreement.depth_median_mm, 'mm')} median, "
        f"{number(agreement.depth_p95_mm, 'mm')} at 95 %, bias {number(agreement.depth_bias_mm, 'mm')}; "
        f"overlap {number(agreement.silhouette_iou)}; normals {number(agreement.normal_median_deg, 'deg')}</p>"
        f"<div class='tiles{' three' if full else ''}'>{''.join(pictures)}</div>"
        f"{tiles(maps)}</section>"
    )


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "absent"
