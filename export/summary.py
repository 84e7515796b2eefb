"""What an export says of itself."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gazenerf.export.formats.files import part_files
from gazenerf.export.part_mesh import PartMesh


def mesh_rows(
    meshes: Mapping[str, PartMesh], out: Path, formats: Sequence[str], volumes: Sequence[str] = ()
) -> dict[str, object]:
    """Rows for the closing table: files written and what was measured of each part."""
    rows: dict[str, object] = {}
    for part, extracted in meshes.items():
        files = part_files(
            part,
            tuple(formats),
            texture=extracted.textured is not None,
            points=extracted.points is not None,
            volumes=tuple(volumes),
        )
        rows |= {f"{part} {kind}": out / name for kind, name in files.items()}
        threshold = extracted.threshold
        if threshold is None:
            rows[f"{part} surface"] = extracted.steps[0]
        else:
            chosen = f"{threshold.level:g} per unit ({threshold.how})"
            if np.isfinite(threshold.depth_error_mm):
                chosen += f", {threshold.depth_error_mm:.2f} mm median from the rendered depth"
            rows[f"{part} threshold"] = chosen
        mesh = extracted.mesh
        kind = "watertight" if mesh.is_watertight else "open"
        rows[f"{part} mesh"] = f"{len(mesh.vertices):,} vertices, {len(mesh.faces):,} faces, {kind}"
        about = json.loads((out / files["json"]).read_text())
        pierced = about["self_intersecting_faces"]
        rows[f"{part} pieces"] = f"{about['components']}, self-intersecting faces: " + (
            "not counted" if pierced is None else f"{pierced:,}"
        )
        if (away := about.get("median_mm_from_the_head_model_in_the_face_crop")) is not None:
            rows[f"{part} crop"] = f"{away:.2f} mm median from the head model in the face crop"
        if threshold is not None:
            rows[f"{part} queries"] = f"{extracted.queries:,} of {int(np.prod(extracted.grid)):,} grid points"
        if extracted.textured is not None:
            rows[f"{part} texture"] = _texture_line(about)
    return rows


def _texture_line(about: Mapping[str, Any]) -> str:
    texture, compared = about["texture"], about["texture_against_the_field"]
    line = f"{texture['size']} px, {texture['charts']} charts"
    if "not_measured" in compared:
        return f"{line}; not compared with the field: {compared['not_measured']}"
    measured = [f"{value:.1f}" for value in compared["psnr_db"] if value is not None]
    return f"{line}; PSNR {', '.join(measured)} dB against the field's own pictures from unseen views"


def rig_rows(out: Path) -> dict[str, object]:
    """Rows on the rig in a folder and its fitted eyeballs."""
    rows: dict[str, object] = {f"rig {path.suffix[1:]}": path for path in sorted(out.glob("rig.*"))}
    facts = json.loads((out / "rig.json").read_text())
    for side in ("eye_left", "eye_right"):
        eye = facts[side]
        text = f"radius {eye['radius_mm']:.2f} mm, fit {eye['fit_residual_mm']:.2f} mm RMS"
        if "centre_distance_mm" in eye:
            text += f", centre {eye['centre_distance_mm']:.2f} mm from the head model's"
        rows[side.replace("_", " ")] = text
    return rows


def sequence_rows(out: Path, numbered: bool) -> dict[str, object]:
    """Rows on a gaze sequence in a folder."""
    if numbered:
        return {"sequence": f"{out / 'sequence'}, {len(list((out / 'sequence').iterdir()))} gazes"}
    followed = json.loads((out / "sequence.json").read_text())["followed"]
    largest = max(follow["largest_move_mm"] for follow in followed)
    left = [follow["median_distance_after_mm"] for follow in followed]
    left = [value for value in left if value is not None]
    text = f"{len(followed)} gazes, lids move up to {largest:.2f} mm"
    if left:
        text += f" and end {np.median(left):.3f} mm (median) from the surface of each gaze"
    return {"sequence glb": out / "sequence.glb", "sequence json": out / "sequence.json", "sequence": text}
