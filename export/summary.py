"""What an export says of itself: rows of the closing table."""

from __future__ import annotations

import numpy as np

from gazenerf.export.formats.files import Facts, WrittenPart
from gazenerf.export.part_mesh import PartMesh
from gazenerf.export.pipeline import MeshReport
from gazenerf.export.surface.coverage import NEAR_MM, Coverage


def mesh_rows(report: MeshReport) -> dict[str, object]:
    """Files written and what was measured, of parts, rig and sequence."""
    rows: dict[str, object] = {}
    for part, written in report.parts.items():
        rows |= _part_rows(part, written)
    if "rig" in report.scenes:
        rows |= {f"rig {kind}": path for kind, path in sorted(report.scenes["rig"].files.items())}
        rows |= _eye_rows(report.scenes["rig"].facts)
    if "sequence" in report.scenes:
        scene = report.scenes["sequence"]
        rows |= {f"sequence {kind}": path for kind, path in scene.files.items()}
        rows["sequence"] = _sequence_line(scene.facts)
    if report.numbered:
        rows["sequence"] = f"{report.numbered[0].parent}, {len(report.numbered)} gazes"
    return rows


def mesh_facts(report: MeshReport) -> Facts:
    """Part, `rig` and `sequence` to what their sidecars say."""
    parts: Facts = {part: written.facts for part, written in report.parts.items()}
    return parts | {name: scene.facts for name, scene in report.scenes.items()}


def part_line(written: WrittenPart) -> str:
    """One part in one line: size, whether it is closed, voxels, threshold, distance from the rendered depth."""
    facts = written.facts
    closed = "watertight" if facts["watertight"] else "open"
    line = f"{facts['vertices']:,} vertices, {facts['faces']:,} faces, {closed}, {facts['voxel_mm']:.2f} mm voxels"
    if facts["threshold_per_world_unit"] is not None:
        line += f", threshold {facts['threshold_per_world_unit']:g}"
    off = facts.get("depth_disagreement_mm")
    return line + ("" if off is None else f", {off:.2f} mm median from the rendered depth")


def rig_line(facts: Facts) -> str:
    """A rig in one line."""
    left, right = (facts[side]["radius_mm"] for side in ("eye_left", "eye_right"))
    return f"eyeballs of {left:.2f} and {right:.2f} mm that turn, lids that follow; index.html shows it in any browser"


def _part_rows(part: str, written: WrittenPart) -> dict[str, object]:
    extracted, about = written.extracted, written.facts
    rows: dict[str, object] = {f"{part} {kind}": path for kind, path in written.files.items()}
    threshold = extracted.threshold
    if threshold is None:
        rows[f"{part} surface"] = extracted.steps[0]
    else:
        rows[f"{part} threshold"] = f"{threshold.level:g} per unit ({threshold.how})"
    rows |= _coverage_rows(part, extracted.coverage)
    kind = "watertight" if about["watertight"] else "open"
    rows[f"{part} mesh"] = f"{about['vertices']:,} vertices, {about['faces']:,} faces, {kind}"
    pierced = about["self_intersecting_faces"]
    rows[f"{part} pieces"] = f"{about['components']}, self-intersecting faces: " + (
        "not counted" if pierced is None else f"{pierced:,}"
    )
    if (away := about.get("median_mm_from_the_head_model_in_the_face_crop")) is not None:
        rows[f"{part} crop"] = f"{away:.2f} mm median from the head model in the face crop"
    if threshold is not None:
        rows[f"{part} queries"] = _queries_line(extracted)
    if extracted.textured is not None:
        rows[f"{part} texture"] = _texture_line(about)
    return rows


def _queries_line(extracted: PartMesh) -> str:
    points = int(np.prod(extracted.grid))
    if extracted.volume is None:
        return f"{extracted.queries:,} of {points:,} grid points"
    return f"{points:,}, the whole grid, and {extracted.queries - points:,} to find its box and the threshold"


def _coverage_rows(part: str, found: Coverage) -> dict[str, object]:
    off = "" if np.isnan(found.depth_error_mm) else f"{found.depth_error_mm:.2f} mm median from the rendered depth, "
    rows: dict[str, object] = {
        f"{part} depth": f"{off}{found.missing:.1%} of which has no surface within {NEAR_MM:g} mm; "
        f"{found.unrendered:.1%} of the surface is not rendered"
    }
    if found.lost:
        rows[f"{part} lost"] = "; ".join(f"{lost.area_cm2:.1f} cm2 {lost.where}" for lost in found.lost)
    return rows


def _texture_line(about: Facts) -> str:
    texture, compared = about["texture"], about["texture_against_the_field"]
    line = f"{texture['size']} px, {texture['charts']} charts"
    if "not_measured" in compared:
        return f"{line}; not compared with the field: {compared['not_measured']}"
    measured = [f"{value:.1f}" for value in compared["psnr_db"] if value is not None]
    return f"{line}; PSNR {', '.join(measured)} dB against the field's own pictures from unseen views"


def _eye_rows(facts: Facts) -> dict[str, object]:
    rows: dict[str, object] = {}
    for side in ("eye_left", "eye_right"):
        eye = facts[side]
        text = f"radius {eye['radius_mm']:.2f} mm, fit {eye['fit_residual_mm']:.2f} mm RMS"
        if "centre_distance_mm" in eye:
            text += f", centre {eye['centre_distance_mm']:.2f} mm from the head model's"
        rows[side.replace("_", " ")] = text
    return rows


def _sequence_line(facts: Facts) -> str:
    followed = facts["followed"]
    largest = max(follow["largest_move_mm"] for follow in followed)
    left = [follow["median_distance_after_mm"] for follow in followed]
    left = [value for value in left if value is not None]
    text = f"{len(followed)} gazes, lids move up to {largest:.2f} mm"
    if left:
        text += f" and end {np.median(left):.3f} mm (median) from the surface of each gaze"
    return text
