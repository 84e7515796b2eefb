"""The report on somebody else's frames."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from gazenerf.files import whole_folder
from gazenerf.viz.check.frames_check import FramesResult, Warp
from gazenerf.viz.metrics.orbit_pictures import match_picture
from gazenerf.viz.metrics.tsed import MIN_MATCHES, PairMatches
from gazenerf.viz.report.page import (
    counts,
    escape,
    figure,
    number,
    page,
    photograph,
    slider,
    table,
    verdict_table,
    worst_sentence,
)
from gazenerf.viz.report.sections import sfm_sentence, strip_figure, tsed_table
from gazenerf.viz.report.write import NUMBERS, REPORT, footer, provenance

SHOWN_PAIRS = 4


def write_frames_report(result: FramesResult, out: str | Path) -> tuple[Path, Path]:
    """Write `report.html` and `report.json` to a folder; both appear or neither does."""
    out = Path(out)
    numbers = result.to_dict() | provenance()
    with whole_folder(out) as folder:
        (folder / REPORT).write_text(render_frames_page(result, numbers), encoding="utf-8")
        (folder / NUMBERS).write_text(json.dumps(numbers, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    return out / REPORT, out / NUMBERS


def render_frames_page(result: FramesResult, numbers: dict[str, Any]) -> str:
    """The page as text; every picture is inside it."""
    about = result.about
    left_out = "".join(f"<li>{escape(what)}: {escape(why)}.</li>" for what, why in result.unmeasured.items())
    notes = "".join(f"<li>{escape(note)}</li>" for note in result.notes)
    sections = [
        f"<h1>Do the frames of {escape(str(about['subject']))} show one 3D scene?</h1><p class=quiet>{about['frames']} "
        f"frames of {about['width_px']}x{about['height_px']} px, {about['depth_frames']} of them with depth.</p>",
        counts(result.metrics) + worst_sentence(result.metrics),
        "<h2>Verdict</h2><p class=quiet>&plusmn; is half the 95 % interval over pairs.</p>"
        f"{verdict_table(result.metrics)}",
        f"<h2>What was left out</h2><ul>{left_out}{notes}</ul>" if left_out or notes else "",
        _matches(result, numbers),
        _warps(result),
        _strip(result),
        footer(numbers, f"Seed {about['seed']}"),
    ]
    return page(f"Consistency of {about['subject']}", "\n".join(part for part in sections if part))


def _badness(pair: PairMatches) -> tuple[bool, float]:
    return pair.matches < MIN_MATCHES, math.inf if math.isnan(pair.median_px) else pair.median_px


def _matches(result: FramesResult, numbers: dict[str, Any]) -> str:
    if not result.tsed.pairs:
        return ""
    worst = sorted(result.tsed.pairs, key=_badness, reverse=True)[:SHOWN_PAIRS]
    shown = "".join(
        figure(
            photograph(match_picture(pair, result.frames[pair.a].image, result.frames[pair.b].image)),
            f"{result.frames[pair.a].name} and {result.frames[pair.b].name}: {pair.matches} matches, "
            f"{number(pair.median_px, 'px')} from their lines",
        )
        for pair in worst
    )
    return (
        "<h2>Pictures against their cameras</h2><p class=quiet>Matched features of neighbouring frames, worst pair "
        "first: green within 2 px of the epipolar line that the cameras give, red beyond. An error along those lines "
        f"is not seen.</p><div class='tiles two tall'>{shown}</div>{tsed_table(numbers['tsed_pairs'])}"
        f"{sfm_sentence(numbers['structure_from_motion'])}"
    )


def _warps(result: FramesResult) -> str:
    if not result.warps:
        return ""

    def badness(warp: Warp) -> float:
        return math.inf if math.isnan(warp.result.warp_psnr) else warp.result.warp_psnr

    ordered = sorted(result.warps, key=badness)
    names = [frame.name for frame in result.frames]
    rows = [
        [
            f"{escape(names[w.a])} from {escape(names[w.b])}, {w.degrees:.0f}&deg;",
            number(w.result.consistent),
            number(w.result.round_trip_px, "px"),
            number(w.result.warp_psnr, "dB"),
            number(w.result.warp_ssim),
        ]
        for w in ordered
    ]
    worst = ordered[0]
    pictures = ""
    if result.worst_warp is not None:
        own = result.frames[worst.a].image
        seen = np.isfinite(result.worst_warp).all(axis=-1, keepdims=True)
        warped = np.where(seen, np.clip(np.nan_to_num(result.worst_warp), 0.0, 1.0), 0.5)
        both = slider(
            photograph(np.where(seen, own, 128).astype(np.uint8)),
            photograph(warped),
            f"worst pair: left {names[worst.a]}, right {names[worst.b]} warped onto it; grey was not judged",
        )
        pictures = f"<div class='tiles two tall'>{both}</div>"
    return (
        "<h2>Views against each other, by their depth</h2><p class=quiet>Every pixel of one frame carried by its depth "
        f"into another and back; the other picture warped along. Worst pair first.</p>{pictures}"
        + table(["pair", "consistent", "round trip", "warped", "SSIM"], rows)
    )


def _strip(result: FramesResult) -> str:
    strip = result.strip
    if strip is None:
        return ""
    caption = f"row {strip.row} of {len(strip.frames)} frames over {strip.degrees:.0f}° of azimuth"
    return (
        "<h2>Epipolar-plane image</h2><p class=quiet>One row of the picture, frame under frame, over the orbit. "
        "Smooth slanted or curved traces are texture on the scene; vertical lines stick to the screen; broken ones "
        "flicker.</p>"
        f"<div class='tiles two tall'>{strip_figure(strip.image, caption)}</div>"
    )
