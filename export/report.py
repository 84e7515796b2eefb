"""What an export says of itself."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from export.files import part_files
from export.meshes import PartMesh


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
        if threshold is not None:
            rows[f"{part} queries"] = f"{extracted.queries:,} of {int(np.prod(extracted.grid)):,} grid points"
        if extracted.textured is not None:
            rows[f"{part} texture"] = _texture_line(json.loads((out / files["json"]).read_text()))
    return rows


def _texture_line(about: Mapping[str, dict]) -> str:
    texture, compared = about["texture"], about["texture_against_the_field"]
    line = f"{texture['size']} px, {texture['charts']} charts"
    if "not_measured" in compared:
        return f"{line}; not compared with the field: {compared['not_measured']}"
    measured = [f"{value:.1f}" for value in compared["psnr_db"] if value is not None]
    return f"{line}; PSNR {', '.join(measured)} dB against the field's own pictures from unseen views"


def rig_rows(sidecar: Path) -> dict[str, object]:
    """Rows on the fitted eyeballs, from a rig's sidecar."""
    facts = json.loads(sidecar.read_text())
    rows: dict[str, object] = {}
    for side in ("eye_left", "eye_right"):
        eye = facts[side]
        text = f"radius {eye['radius_mm']:.2f} mm, fit {eye['fit_residual_mm']:.2f} mm RMS"
        if "centre_distance_mm" in eye:
            text += f", centre {eye['centre_distance_mm']:.2f} mm from the head model's"
        rows[side.replace("_", " ")] = text
    return rows
