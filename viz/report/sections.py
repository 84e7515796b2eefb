"""The parts of a check's page below the views: strips, eyes, streams, drift, orbit, renderers, error mesh."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from gazenerf.viz.check.result import CheckResult
from gazenerf.viz.metrics.pairs import PairReading
from gazenerf.viz.pictures.surface_colours import GIVE_UP_MM
from gazenerf.viz.pictures.surface_colours import LIMIT_MM as MESH_LIMIT_MM
from gazenerf.viz.report.blocks import Block, Fold, Gallery, Picture, Section, Table, Text
from gazenerf.viz.report.error_mesh import BESIDE_M, FILE
from gazenerf.viz.report.page import photograph
from gazenerf.viz.report.plots import scatter
from gazenerf.viz.report.readable import UNMEASURED, degrees, number
from gazenerf.viz.report.views import scalar_bar

PAIR_COLUMNS = {
    "consistent": ("consistent depth", ""),
    "round_trip_px": ("round trip", "px"),
    "warp_ssim": ("SSIM", ""),
    "warp_psnr": ("PSNR", "dB"),
}
"""Readings of a pair that are tabled: name to heading and unit."""

REACH_NAMES = {"short": "about 5°", "long": "about 30°"}
STREAM_NAMES = {"head": "merged picture", "face": "face stream alone", "eyes": "eyes stream alone"}

EPI_MEANING = (
    "The same row of the picture from every frame, stacked from top to bottom in the order of the orbit. Texture on "
    "the surface draws smooth slanted or curved traces; texture that sticks to the screen draws vertical lines; "
    "flicker breaks the traces."
)


def strips_section(result: CheckResult) -> Section | None:
    """The epipolar-plane images."""
    if not result.strips:
        return None
    first, last = result.strip_degrees
    shown = tuple(
        strip_picture(image, f"through the {name}, yaw {degrees(first)} (top) to {degrees(last)} (bottom)")
        for name, image in result.strips.items()
    )
    return Section("Epipolar-plane images", (Text(EPI_MEANING), Gallery(shown, "pair")))


def strip_picture(image: np.ndarray, caption: str) -> Picture:
    """An epipolar-plane image (frames, W, 3), its rows repeated until it is about three quarters as high as wide."""
    rows_each = max(1, round(0.75 * image.shape[1] / len(image)))
    return Picture(photograph(np.repeat(image, rows_each, axis=0)), caption, crisp=True)


def eyes_section(result: CheckResult) -> Section | None:
    """Commanded against measured gaze, the eyes' pictures, and what else moved."""
    eyes = result.eyes
    if eyes is None:
        return None
    plots = tuple(
        scatter(
            {f"{eye} eye": (eyes.commanded[:, axis], measured[:, axis]) for eye, measured in eyes.measured.items()},
            f"{name}: measured against commanded",
            "commanded, degrees",
            "measured, degrees",
        )
        for axis, name in enumerate(("Pitch", "Yaw"))
    )
    rows = tuple(
        (
            _angles(commanded),
            *(_angles(eyes.measured[eye][i]) for eye in eyes.measured),
            number(max((float(spread[i]) for spread in eyes.spread_deg.values()), default=math.nan), "deg"),
            number(float(eyes.pose_change_mm[i]), "mm"),
            number(float(eyes.face_change_psnr[i]), "dB") if np.isfinite(eyes.face_change_psnr[i]) else "the first",
        )
        for i, commanded in enumerate(eyes.commanded)
    )
    head = ("commanded pitch/yaw", *(f"{eye} eye measured" for eye in eyes.measured), "spread over views",
            "head moved", "rest of the face, PSNR")  # fmt: skip
    pictures = tuple(
        Picture(photograph(picture), f"commanded {_angles(commanded)}")
        for picture, commanded in zip(eyes.pictures, eyes.commanded, strict=True)
    )
    return Section(
        "Eyes over a gaze grid",
        (
            Text(
                "Pitch is positive upward, yaw toward the subject's left; both in degrees. The gaze is measured from "
                "the irises in several views; on the dashed line, measured equals commanded. How far the head moved, "
                "and how alike the rest of the face stays, is measured against the first gaze."
            ),
            Gallery(plots, "pair"),
            Gallery(pictures, "three"),
            Table(head, rows),
        ),
    )


def _angles(pair: np.ndarray) -> str:
    if not np.isfinite(pair).all():
        return "not found"
    pitch, yaw = np.round(pair, 1) + 0.0  # no minus before a zero
    return f"{pitch:+.1f}/{yaw:+.1f}"


def streams_section(result: CheckResult) -> Section | None:
    """Pairs of views, for the merged picture and each stream."""
    if not result.streams:
        return None
    summary = tuple(
        (
            f"{STREAM_NAMES.get(part, part)}, {REACH_NAMES.get(reach, reach)}, {_count(len(chosen))}",
            *(
                number(_middle([getattr(pair.whole, name) for pair in chosen]), unit)
                for name, (_, unit) in PAIR_COLUMNS.items()
            ),
            number(
                min((p.whole.warp_psnr for p in chosen if math.isfinite(p.whole.warp_psnr)), default=math.nan), "dB"
            ),
            number(_middle([p.eye_region.warp_psnr for p in chosen]), "dB"),
        )
        for part, pairs in result.streams.items()
        for reach in dict.fromkeys([*REACH_NAMES, *(pair.reach for pair in pairs)])
        if (chosen := [pair for pair in pairs if pair.reach == reach])
    )
    rows = tuple(
        _pair_row(part, pair)
        for part, pairs in result.streams.items()
        for pair in sorted(pairs, key=lambda p: np.nan_to_num(p.whole.warp_psnr, nan=math.inf))
    )
    columns = tuple(heading for heading, _ in PAIR_COLUMNS.values())
    return Section(
        "Views against each other",
        (
            Text(
                "Every pixel of one view is carried by its depth into another view and back, and the other view's "
                "picture is warped along. Consistent depth is the share of pixels that return to where they started; "
                "SSIM and PSNR compare the warped picture with the view's own. Values are medians over pairs of views, "
                "and the PSNR of the worst pair."
            ),
            Table(("stream and angle", *columns, "worst PSNR", "eye region, PSNR"), summary),
            Fold(
                f"All {len(rows)} pairs, each stream's worst first",
                (Table(("pair", *columns, "eye region, PSNR"), rows),),
            ),
        ),
    )


def _count(pairs: int) -> str:
    return "1 pair" if pairs == 1 else f"{pairs} pairs"


def _pair_row(part: str, pair: PairReading) -> tuple[str, ...]:
    return (
        f"{pair.a} from {pair.b}, {STREAM_NAMES.get(part, part)}, {pair.degrees:.0f}°",
        *(number(getattr(pair.whole, name), unit) for name, (_, unit) in PAIR_COLUMNS.items()),
        number(pair.eye_region.warp_psnr, "dB"),
    )


def _middle(values: list[float]) -> float:
    known = [value for value in values if math.isfinite(value)]
    return float(np.median(known)) if known else math.nan


def drift_section(result: CheckResult) -> Section | None:
    """Pictures against their volumes."""
    drift = result.drift
    if drift is None:
        return None
    views = tuple(
        (v.view, number(v.iou), _pixels(v.outline_px), _pixels(v.shift_px), number(v.explained)) for v in drift.views
    )
    pairs = tuple((f"{p.a} from {p.b}", number(p.unfollowed), number(p.stuck)) for p in drift.pairs)
    texture = Fold(
        f"Fine texture of {len(pairs)} pairs of views",
        (Table(("pair", "does not follow the surface", "stays on the screen"), pairs),),
    )
    return Section(
        "Picture against its volume",
        (
            Text(
                "The neural renderer draws the picture from a smaller feature map: "
                f"{drift.pixels_a_feature:g} × {drift.pixels_a_feature:g} pixels from each of its pixels. Shifts are "
                "in pixels of the picture, to the right and down. A shift by half a feature pixel would be "
                f"{0.5 * drift.pixels_a_feature:g} px."
            ),
            Table(
                ("view", "silhouette, IoU", "shift of the outline", "shift of the picture", "explained by the volume"),
                views,
            ),
            *((texture,) if pairs else ()),
        ),
    )


def _pixels(shift: tuple[float, float]) -> str:
    return f"{shift[0]:+.2f}, {shift[1]:+.2f}" if all(map(math.isfinite, shift)) else UNMEASURED


def tsed_section(numbers: dict[str, Any]) -> Section | None:
    """An orbit's features against its cameras, and what COLMAP made of it."""
    pairs = numbers.get("tsed_pairs")
    if not pairs:
        return None
    return Section(
        "Pictures of an orbit against their cameras",
        (
            Text(
                "Features are matched between neighbouring pictures of an orbit; the distance is how far a matched "
                "feature lies from the epipolar line that the known cameras give it. An error along that line is not "
                "seen."
            ),
            Fold(f"All {len(pairs)} pairs, worst first", (tsed_table(pairs),)),
            *sfm_text(numbers.get("structure_from_motion")),
        ),
    )


def tsed_table(pairs: Iterable[dict[str, Any]]) -> Table:
    """Pairs of report.json, worst first."""
    ordered = sorted(pairs, key=lambda p: -math.inf if p["median_px"] is None else -p["median_px"])
    rows = tuple((f"{p['a']} and {p['b']}", f"{p['matches']}", number(p["median_px"], "px")) for p in ordered)
    return Table(("pair", "matches", "distance, median"), rows)


def sfm_text(found: dict[str, Any] | None) -> tuple[Text, ...]:
    """What COLMAP found, in one sentence; nothing when it did not run."""
    if found is None:
        return ()
    if found["reason"]:
        return (Text(f"Structure from motion: {found['reason']}.", quiet=False),)
    error, off, turn = (
        number(found[key], unit)
        for key, unit in (("reprojection_px", "px"), ("position_percent", "%"), ("turn_deg", "deg"))
    )
    return (
        Text(
            f"COLMAP registered {found['registered']} of {found['pictures']} pictures with {found['points']} points "
            f"and a mean reprojection error of {error}. After a similarity fit, the median camera lies {off} of its "
            f"distance away from where it was given and is turned by {turn}.",
            quiet=False,
        ),
    )


def renderers_section(result: CheckResult) -> Section:
    """The reference renderers against each other, and those that did not start."""
    absent = tuple(
        Text(f"The reference renderer {name} could not start; {fix}.", quiet=False)
        for name, fix in result.missing.items()
    )
    title = "Reference renderers against each other"
    if not result.between:
        return Section(title, (*absent, Text("Only one renderer ran, so there is nothing to compare it with.")))
    rows = tuple(
        (f"{view}, {a} and {b}", number(r.depth_median_mm, "mm"), number(r.depth_p95_mm, "mm"),
         number(r.silhouette_px, "px"), number(r.normal_median_deg, "deg"))
        for a, b, view, r in result.between
    )  # fmt: skip
    return Section(
        title,
        (
            *absent,
            Text(
                "Two programs drew the same reference head. What they differ by is the precision of the reference "
                "itself."
            ),
            Fold(
                f"All {len(rows)} pairs of renders",
                (Table(("view", "depth, median", "depth, 95th percentile", "silhouette", "normals"), rows),),
            ),
        ),
    )


def error_mesh_section(facts: dict[str, Any] | None) -> Section | None:
    """The key of error.glb and its distances."""
    if facts is None:
        return None
    rows = tuple(
        (name, f"{side['compared']:,} of {side['vertices']:,}",
         *(number(side[f"{q}_percentile_mm"], "mm") for q in (5, 50, 95)))
        for name, side in (("field", facts["field"]), ("reference", facts["reference"]))
    )  # fmt: skip
    blocks: tuple[Block, ...] = (
        Text(
            f"{FILE}, in the folder of this page, holds the field's surface and, {BESIDE_M:g} m beside it, the "
            "reference head. Each is coloured by its signed distance from the other. Any glTF viewer opens it; its "
            "units are metres, Y up.",
            quiet=False,
        ),
        scalar_bar(f"{MESH_LIMIT_MM:g} mm, field stands out", f"{MESH_LIMIT_MM:g} mm, field too deep"),
        Text(f"Grey: nothing of the other surface within {GIVE_UP_MM:g} mm."),
        Table(("surface", "vertices compared", "5th percentile", "median", "95th percentile"), rows),
    )
    return Section("Error mesh", blocks)
