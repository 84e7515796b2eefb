"""The parts of a check's page below the views: strips, eyes, streams, drift, orbit, renderers, error mesh."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from gazenerf.viz.check.result import CheckResult
from gazenerf.viz.metrics.pairs import PairReading
from gazenerf.viz.report.error_mesh import FILE, GIVE_UP_MM
from gazenerf.viz.report.error_mesh import LIMIT_MM as MESH_LIMIT_MM
from gazenerf.viz.report.heatmaps import colour_bar
from gazenerf.viz.report.page import chart, escape, figure, folded, number, photograph, table
from gazenerf.viz.report.plots import scatter

PAIR_COLUMNS = {"consistent": "", "round_trip_px": "px", "warp_ssim": "", "warp_psnr": "dB"}
"""Readings of a pair that are tabled, with their units."""

REACH_NAMES = {"short": "about 5&deg;", "long": "about 30&deg;"}
STREAM_NAMES = {"head": "merged picture", "face": "face stream alone", "eyes": "eyes stream alone"}


def scalar_bar(low: str, high: str) -> str:
    """The key of signed millimetres."""
    return (
        f"<div class=key>{escape(low)}<img alt='colours from blue over white to red' src='{chart(colour_bar())}'>"
        f"{escape(high)}</div>"
    )


def strips_section(result: CheckResult) -> str:
    """The epipolar-plane images."""
    if not result.strips:
        return ""
    first, last = result.strip_degrees
    shown = "".join(
        strip_figure(image, f"through the {name}, yaw {first:+.0f}° (top) to {last:+.0f}°")
        for name, image in result.strips.items()
    )
    return (
        "<h2>Epipolar-plane images</h2><p class=quiet>One row of the picture, frame under frame, over an orbit. Smooth "
        "slanted or curved traces are texture on the head; vertical lines stick to the screen; broken ones flicker.</p>"
        f"<div class='tiles two tall'>{shown}</div>"
    )


def strip_figure(image: np.ndarray, caption: str) -> str:
    """An epipolar-plane image, its rows drawn so high that the picture is about three quarters as high as wide."""
    rows_each = max(1, round(0.75 * image.shape[1] / len(image)))
    return figure(photograph(np.repeat(image, rows_each, axis=0)), caption, "strip")


def eyes_section(result: CheckResult) -> str:
    """Commanded against measured gaze, the eyes' pictures, and what else moved."""
    eyes = result.eyes
    if eyes is None:
        return ""
    plots = "".join(
        "<figure>"
        + scatter(
            {f"{eye} eye": (eyes.commanded[:, axis], measured[:, axis]) for eye, measured in eyes.measured.items()},
            f"{name}: measured against commanded",
            "commanded, degrees",
            "measured, degrees",
        )
        + "</figure>"
        for axis, name in enumerate(("pitch", "yaw"))
    )
    rows = [
        [
            f"{pitch:+.0f}/{yaw:+.0f}",
            *(_angles(eyes.measured[eye][i]) for eye in eyes.measured),
            number(max((float(spread[i]) for spread in eyes.spread_deg.values()), default=math.nan), "deg"),
            number(float(eyes.pose_change_mm[i]), "mm"),
            number(float(eyes.face_change_psnr[i]), "dB") if np.isfinite(eyes.face_change_psnr[i]) else "the first",
        ]
        for i, (pitch, yaw) in enumerate(eyes.commanded)
    ]
    head = ["commanded pitch/yaw", *(f"{eye} eye reads" for eye in eyes.measured), "spread over views", "head moved",
            "rest of the face"]  # fmt: skip
    pictures = "".join(
        figure(photograph(picture), f"commanded {pitch:+.0f}/{yaw:+.0f}")
        for picture, (pitch, yaw) in zip(eyes.pictures, eyes.commanded, strict=True)
    )
    return (
        "<h2>Eyes over a gaze grid</h2><p class=quiet>Pitch up and yaw to the subject's left are positive. The gaze is "
        "read from the irises of several views; the dashed line is where measured equals commanded.</p>"
        f"<div class='tiles two tall'>{plots}</div><div class='tiles three'>{pictures}</div>{table(head, rows)}"
    )


def _angles(pair: np.ndarray) -> str:
    return f"{pair[0]:+.1f}/{pair[1]:+.1f}" if np.isfinite(pair).all() else "not found"


def streams_section(result: CheckResult) -> str:
    """Pairs of views, for the merged picture and each stream."""
    if not result.streams:
        return ""
    summary = [
        [
            f"{escape(STREAM_NAMES.get(part, part))}, {REACH_NAMES.get(reach, reach)}, {len(chosen)} pairs",
            *(number(_median(chosen, name), unit) for name, unit in PAIR_COLUMNS.items()),
            number(
                min((p.whole.warp_psnr for p in chosen if math.isfinite(p.whole.warp_psnr)), default=math.nan), "dB"
            ),
            number(_middle([p.eye_region.warp_psnr for p in chosen]), "dB"),
        ]
        for part, pairs in result.streams.items()
        for reach in dict.fromkeys(pair.reach for pair in pairs)
        if (chosen := [pair for pair in pairs if pair.reach == reach])
    ]
    rows = [
        [
            f"{escape(pair.a)} from {escape(pair.b)}, {escape(STREAM_NAMES.get(part, part))}, {pair.degrees:.0f}&deg;",
            *(number(getattr(pair.whole, name), unit) for name, unit in PAIR_COLUMNS.items()),
            number(pair.eye_region.warp_psnr, "dB"),
        ]
        for part, pairs in result.streams.items()
        for pair in sorted(pairs, key=lambda p: np.nan_to_num(p.whole.warp_psnr, nan=math.inf))
    ]
    head = ["consistent", "round trip", "SSIM", "warped"]
    return (
        "<h2>Views against each other</h2><p class=quiet>Every pixel of one view carried by its depth into another and "
        "back; the other picture warped along. Each stream also alone. Medians over pairs, and the worst pair.</p>"
        + table(["stream", *head, "worst", "eye region"], summary)
        + folded(f"All {len(rows)} pairs, each stream's worst first", table(["pair", *head, "eye region"], rows))
    )


def _middle(values: list[float]) -> float:
    known = [value for value in values if math.isfinite(value)]
    return float(np.median(known)) if known else math.nan


def _median(pairs: list[PairReading], name: str) -> float:
    return _middle([getattr(pair.whole, name) for pair in pairs])


def drift_section(result: CheckResult) -> str:
    """Pictures against their volumes."""
    drift = result.drift
    if drift is None:
        return ""
    views = [
        [escape(v.view), number(v.iou), _pixels(v.outline_px), _pixels(v.shift_px), number(v.explained)]
        for v in drift.views
    ]
    pairs = [[f"{escape(p.a)} from {escape(p.b)}", number(p.unfollowed), number(p.stuck)] for p in drift.pairs]
    textures = table(["pair", "does not follow the surface", "stays on the screen"], pairs)
    return (
        "<h2>Picture against its volume</h2><p class=quiet>The neural renderer draws "
        f"{drift.pixels_a_feature:g} x {drift.pixels_a_feature:g} pixels from each pixel of its feature map. Shifts "
        "are right and down, in pixels of the picture; half a feature pixel is "
        f"{0.5 * drift.pixels_a_feature:g} px.</p>"
        f"{table(['view', 'silhouette, IoU', 'outline shift', 'picture shift', 'explained by the volume'], views)}"
        f"{folded(f'Fine texture of {len(pairs)} pairs', textures) if pairs else ''}"
    )


def _pixels(shift: tuple[float, float]) -> str:
    return f"{shift[0]:+.2f}, {shift[1]:+.2f}" if all(map(math.isfinite, shift)) else "not measured"


def tsed_section(numbers: dict[str, Any]) -> str:
    """An orbit's features against its cameras, and what COLMAP made of it."""
    pairs = numbers.get("tsed_pairs")
    if not pairs:
        return ""
    return (
        "<h2>Pictures of an orbit against their cameras</h2><p class=quiet>Matched features and how far they lie from "
        "the epipolar lines of the known cameras. An error along those lines is not seen.</p>"
        f"{tsed_table(pairs)}{sfm_sentence(numbers.get('structure_from_motion'))}"
    )


def tsed_table(pairs: Iterable[dict[str, Any]]) -> str:
    """Pairs of report.json, worst first."""
    rows = [
        [f"{escape(p['a'])} and {escape(p['b'])}", f"{p['matches']}", number(_known(p["median_px"]), "px")]
        for p in sorted(pairs, key=lambda p: -math.inf if p["median_px"] is None else -p["median_px"])
    ]
    return table(["pair", "matches", "distance, median"], rows)


def sfm_sentence(found: dict[str, Any] | None) -> str:
    """What COLMAP found, in one sentence."""
    if found is None:
        return ""
    if found["reason"]:
        return f"<p>Structure from motion: {escape(found['reason'])}.</p>"
    error, off, turn = (
        number(_known(found[key]), unit)
        for key, unit in (("reprojection_px", "px"), ("position_percent", "%"), ("turn_deg", "deg"))
    )
    return (
        f"<p>COLMAP registered {found['registered']} of {found['pictures']} pictures with {found['points']} points, "
        f"mean reprojection error {error}; its cameras lie {off} of their distance and {turn} from the given "
        "ones after a similarity fit (medians).</p>"
    )


def _known(value: float | None) -> float:
    return math.nan if value is None else value


def renderers_section(result: CheckResult) -> str:
    """The reference renderers against each other."""
    title = "<h2>Reference renderers against each other</h2>"
    if not result.between:
        return f"{title}<p>Only one renderer served, so there is nothing to compare it with.</p>"
    rows = [
        [f"{escape(view)}, {escape(a)} and {escape(b)}", number(r.depth_median_mm, "mm"),
         number(r.depth_p95_mm, "mm"), number(r.silhouette_px, "px"), number(r.normal_median_deg, "deg")]
        for a, b, view, r in result.between
    ]  # fmt: skip
    return title + table(["view", "depth, median", "depth, 95 %", "silhouette", "normals"], rows)


def error_mesh_section(facts: dict[str, Any] | None) -> str:
    """The key of error.glb and its distances."""
    if facts is None:
        return ""
    rows = [
        [name, f"{side['compared']:,} of {side['vertices']:,}",
         *(number(_known(side[f"{q}_percentile_mm"]), "mm") for q in (5, 50, 95))]
        for name, side in (("field", facts["field"]), ("reference", facts["reference"]))
    ]  # fmt: skip
    return (
        f"<h2>Error mesh</h2><p><b>{escape(FILE)}</b>, beside this page: the field's surface at the origin and the "
        "reference to its side, each coloured by its signed distance from the other; metres, Y up.</p>"
        + scalar_bar(f"{MESH_LIMIT_MM:g} mm, field stands out", f"{MESH_LIMIT_MM:g} mm, field too deep")
        + f"<p class=quiet>Grey: nothing of the other within {GIVE_UP_MM:g} mm.</p>"
        + table(["surface", "vertices compared", "5 %", "median", "95 %"], rows)
    )
