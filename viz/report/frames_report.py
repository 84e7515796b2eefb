"""The report on a folder of frames that any program made."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from gazenerf.files import whole_folder
from gazenerf.viz.check.frames_check import FramesResult
from gazenerf.viz.metrics.frame_warps import Warp
from gazenerf.viz.metrics.orbit_pictures import match_picture
from gazenerf.viz.metrics.tsed import MIN_MATCHES, PairMatches
from gazenerf.viz.report.blocks import Block, Fold, Gallery, Group, Page, Picture, Section, Slider, Table, Text
from gazenerf.viz.report.common import (
    attention_section,
    left_out_section,
    measures_explained,
    provenance,
    provenance_section,
)
from gazenerf.viz.report.page import photograph, render
from gazenerf.viz.report.readable import number
from gazenerf.viz.report.sections import EPI_MEANING, sfm_text, strip_picture, tsed_table
from gazenerf.viz.report.verdict import FRAMES_CLAIMS, answer, counts, measures, worst
from gazenerf.viz.report.views import thumbnail
from gazenerf.viz.report.write import NUMBERS, REPORT

SHOWN_PAIRS, SHOWN_FRAMES = 4, 12


def write_frames_report(result: FramesResult, out: str | Path) -> tuple[Path, Path]:
    """Write `report.html` and `report.json` to a folder; both appear or neither does."""
    out = Path(out)
    numbers = result.to_dict() | provenance()
    with whole_folder(out) as folder:
        (folder / REPORT).write_text(render(frames_page(result, numbers)), encoding="utf-8")
        (folder / NUMBERS).write_text(json.dumps(numbers, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    return out / REPORT, out / NUMBERS


def frames_page(result: FramesResult, numbers: dict[str, Any]) -> Page:
    """The page of a check of frames; `numbers` is what report.json holds."""
    about = result.about
    left_out = (*(f"{what}: {why}." for what, why in result.unmeasured.items()), *result.notes)
    sections = (
        attention_section(result.metrics),
        Section("Every metric", (measures_explained(), measures(result.metrics))),
        _matches(result, numbers),
        _warps(result),
        _strip(result),
        left_out_section(left_out),
        provenance_section(numbers, f"Seed {about['seed']}"),
    )
    count, deep = about["frames"], about["depth_frames"]
    depth = "all" if deep == count else deep or "none"
    return Page(
        title=f"Consistency of {about['subject']}",
        question=f"Do the frames of {about['subject']} show one 3D scene?",
        about=f"{count} frames of {about['width_px']}×{about['height_px']} px with their cameras, {depth} of "
        "them with depth.",
        answer=answer(result.metrics, FRAMES_CLAIMS),
        tone=worst(result.metrics),
        opening=(counts(result.metrics), *_opening(result)),
        sections=tuple(section for section in sections if section is not None),
    )


def _opening(result: FramesResult) -> tuple[Block, ...]:
    """Some of the frames, and the pair that agrees least."""
    count = len(result.frames)
    chosen = sorted({round(i) for i in np.linspace(0, count - 1, min(count, SHOWN_FRAMES))})
    strip = Gallery(tuple(Picture(thumbnail(result.frames[i].image), result.frames[i].name) for i in chosen), "strip")
    if (slider := _worst_warp(result)) is not None:
        return strip, Group("The two frames that agree least", (Gallery((slider,), "pair"),))
    if result.tsed.pairs:
        pair = max(result.tsed.pairs, key=_badness)
        key = Text(
            "Lines join matched features: green within 2 px of the epipolar line that the cameras give, red beyond."
        )
        return strip, Group("The two frames that agree least", (Gallery((_matched(result, pair),), "pair"), key))
    return (strip,)


def _badness(pair: PairMatches) -> tuple[bool, float]:
    return pair.matches < MIN_MATCHES, math.inf if math.isnan(pair.median_px) else pair.median_px


def _matched(result: FramesResult, pair: PairMatches) -> Picture:
    a, b = result.frames[pair.a], result.frames[pair.b]
    return Picture(
        photograph(match_picture(pair, a.image, b.image)),
        f"{a.name} and {b.name}: {pair.matches} matches, {number(pair.median_px, 'px')} from their epipolar lines",
    )


def _matches(result: FramesResult, numbers: dict[str, Any]) -> Section | None:
    if not result.tsed.pairs:
        return None
    least = sorted(result.tsed.pairs, key=_badness, reverse=True)[:SHOWN_PAIRS]
    pairs = numbers["tsed_pairs"]
    return Section(
        "Pictures against their cameras",
        (
            Text(
                "Features matched between neighbouring frames, worst pair first: green lies within 2 px of the "
                "epipolar line that the cameras give, red beyond. An error along those lines is not seen."
            ),
            Gallery(tuple(_matched(result, pair) for pair in least), "pair"),
            Fold(f"All {len(pairs)} pairs, worst first", (tsed_table(pairs),)),
            *sfm_text(numbers["structure_from_motion"]),
        ),
    )


def _ordered(result: FramesResult) -> list[Warp]:
    """Warps, lowest PSNR first; those that were not judged last."""
    return sorted(result.warps, key=lambda w: math.inf if math.isnan(w.result.warp_psnr) else w.result.warp_psnr)


def _worst_warp(result: FramesResult) -> Slider | None:
    if not result.warps or result.worst_warp is None:
        return None
    pair = _ordered(result)[0]
    a, b = result.frames[pair.a], result.frames[pair.b]
    seen = np.isfinite(result.worst_warp).all(axis=-1, keepdims=True)
    warped = np.where(seen, np.clip(np.nan_to_num(result.worst_warp), 0.0, 1.0), 0.5)
    return Slider(
        photograph(np.where(seen, a.image, 128).astype(np.uint8)),
        photograph(warped),
        a.name,
        f"{b.name} warped onto {a.name}",
        f"Left: {a.name}. Right: {b.name}, warped onto it by its depth. Grey was not judged, since only one of the two "
        f"sees it. PSNR {number(pair.result.warp_psnr, 'dB')}.",
    )


def _warps(result: FramesResult) -> Section | None:
    if not result.warps:
        return None
    names = [frame.name for frame in result.frames]
    rows = tuple(
        (
            f"{names[w.a]} from {names[w.b]}, {w.degrees:.0f}°",
            number(w.result.consistent),
            number(w.result.round_trip_px, "px"),
            number(w.result.warp_psnr, "dB"),
            number(w.result.warp_ssim),
        )
        for w in _ordered(result)
    )
    return Section(
        "Frames against each other, by their depth",
        (
            Text(
                "Every pixel of one frame is carried by its depth into another frame and back, and the other picture "
                "is warped along. Consistent depth is the share of pixels that return to where they started; PSNR and "
                "SSIM compare the warped picture with the frame's own."
            ),
            Fold(
                f"All {len(rows)} pairs, worst first",
                (Table(("pair", "consistent depth", "round trip", "PSNR", "SSIM"), rows),),
            ),
        ),
    )


def _strip(result: FramesResult) -> Section | None:
    strip = result.strip
    if strip is None:
        return None
    caption = f"row {strip.row} of {len(strip.frames)} frames over {strip.degrees:.0f}° of azimuth"
    return Section("Epipolar-plane image", (Text(EPI_MEANING), Gallery((strip_picture(strip.image, caption),), "pair")))
