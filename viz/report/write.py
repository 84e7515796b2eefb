"""A check as one self-contained page and one JSON file."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from gazenerf.files import whole_folder
from gazenerf.heads.interface import BoundField
from gazenerf.viz.check.result import CheckResult, plain
from gazenerf.viz.report.blocks import Block, Page, Section, Text
from gazenerf.viz.report.common import (
    attention_section,
    left_out_section,
    measures_explained,
    provenance,
    provenance_section,
)
from gazenerf.viz.report.error_mesh import ErrorMesh, write_error_mesh
from gazenerf.viz.report.page import render
from gazenerf.viz.report.readable import listed
from gazenerf.viz.report.sections import (
    drift_section,
    error_mesh_section,
    eyes_section,
    renderers_section,
    streams_section,
    strips_section,
    tsed_section,
)
from gazenerf.viz.report.verdict import FIELD_CLAIMS, answer, counts, measures, worst
from gazenerf.viz.report.views import opening, views_section

REPORT, NUMBERS = "report.html", "report.json"


def write_report(
    result: CheckResult, out: str | Path, *, error: ErrorMesh | None = None, bound: BoundField | None = None
) -> tuple[Path, Path]:
    """Write `report.html` and `report.json` to a folder, and `error.glb` where there is one; all appear or none does.

    Args:
        result: What `check_subject` found.
        out: Folder.
        error: Coloured surfaces of `bound`.
        bound: Needed with `error`.

    Returns:
        Paths of the page and of the numbers.
    """
    out = Path(out)
    with whole_folder(out) as folder:
        facts = {}
        if error is not None and bound is not None:
            facts = {"error_mesh": plain(write_error_mesh(error, bound, folder))}
        numbers = result.to_dict() | facts | provenance()
        (folder / REPORT).write_text(render(field_page(result, numbers)), encoding="utf-8")
        (folder / NUMBERS).write_text(json.dumps(numbers, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    return out / REPORT, out / NUMBERS


def field_page(result: CheckResult, numbers: dict[str, Any]) -> Page:
    """The page of a check of a field; `numbers` is what report.json holds."""
    about = result.about
    pitch, yaw = about["gaze_pitch_yaw_degrees"]
    sections = (
        attention_section(result.metrics),
        _measures_section(result),
        views_section(result),
        strips_section(result),
        eyes_section(result),
        streams_section(result),
        drift_section(result),
        tsed_section(numbers),
        renderers_section(result),
        error_mesh_section(numbers.get("error_mesh")),
        left_out_section(result.notes),
        provenance_section(
            numbers,
            f"Weights {about['weights_sha256_16']}, codes {about['codes_sha256_16']}, {about['views']} views of "
            f"{about['size_px']} px, seed {about.get('seed', 0)}",
        ),
    )
    return Page(
        title=f"Consistency of {about['subject']}",
        question=f"Is {about['subject']} one consistent 3D head?",
        about=f"{about['views']} views of the field, commanded gaze: pitch {pitch:+g}°, yaw {yaw:+g}°. The "
        f"reference is the head model fitted to the subject, at the same gaze, drawn by {listed(result.renderers)}.",
        answer=answer(result.metrics, FIELD_CLAIMS),
        tone=worst(result.metrics),
        opening=(counts(result.metrics), *opening(result)),
        sections=tuple(section for section in sections if section is not None),
    )


def _measures_section(result: CheckResult) -> Section:
    blocks: list[Block] = [measures_explained()]
    table = measures(result.metrics)
    if any(family.with_reference for family in table.families):
        blocks.append(
            Text(
                "The column “two references” is what the metric reads between two renders of the reference head: no "
                "field can be expected to do better."
            )
        )
    blocks.append(table)
    percent = result.surfaces.get("scale_percent", math.nan)
    if math.isfinite(percent):
        blocks.append(
            Text(
                f"By a similarity fit the field is {abs(percent):.2f} % {'larger' if percent > 0 else 'smaller'} than "
                "the reference. Surfaces are compared only where the views show them."
            )
        )
    return Section("Every metric", tuple(blocks))
