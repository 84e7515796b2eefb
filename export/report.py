"""What an export says of itself."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from export.meshes import PartMesh


def mesh_rows(meshes: Mapping[str, PartMesh], out: Path, formats: Sequence[str]) -> dict[str, object]:
    """Rows for the closing table: files written and what was measured of each part."""
    rows: dict[str, object] = {}
    for part, extracted in meshes.items():
        for kind in (*formats, "json"):
            rows[f"{part} {kind}"] = out / f"{part}.{kind}"
        threshold = extracted.threshold
        chosen = f"{threshold.level:g} per unit ({threshold.how})"
        if np.isfinite(threshold.depth_error_mm):
            chosen += f", {threshold.depth_error_mm:.2f} mm median from the rendered depth"
        rows[f"{part} threshold"] = chosen
        mesh = extracted.mesh
        kind = "watertight" if mesh.is_watertight else "open"
        rows[f"{part} mesh"] = f"{len(mesh.vertices):,} vertices, {len(mesh.faces):,} faces, {kind}"
        rows[f"{part} queries"] = f"{extracted.queries:,} of {int(np.prod(extracted.grid)):,} grid points"
    return rows


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
