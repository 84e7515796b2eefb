"""Mesh files in metres with a sidecar that says what they are."""

from __future__ import annotations

import json
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import trimesh

from export.colours import vertex_colours
from export.gltf import Node, glb
from gazenerf import __version__
from gazenerf.field.interface import BoundField

if TYPE_CHECKING:
    from export.meshes import PartMesh

FORMATS = ("glb", "ply", "obj")


def in_metres(mesh: trimesh.Trimesh, metres_per_unit: float) -> trimesh.Trimesh:
    """The same mesh scaled to metres, normals and colours kept."""
    return trimesh.Trimesh(
        np.asarray(mesh.vertices) * metres_per_unit,
        mesh.faces,
        vertex_normals=mesh.vertex_normals,
        vertex_colors=vertex_colours(mesh),
        process=False,
    )


def write_mesh(extracted: PartMesh, bound: BoundField, folder: Path, formats: tuple[str, ...]) -> None:
    """Write one part in every format, and its sidecar, to an existing folder."""
    mesh = in_metres(extracted.mesh, bound.metres_per_unit)
    name = extracted.part
    for kind in formats:
        path = folder / f"{name}.{kind}"
        if kind == "glb":
            path.write_bytes(glb(Node(name, mesh)))
        elif kind == "ply":
            mesh.export(path, file_type="ply", vertex_normal=True)
        else:
            mesh.export(path, file_type="obj", include_normals=True, include_color=True)
    write_sidecar(folder / f"{name}.json", sidecar(extracted, bound))


def write_sidecar(path: Path, facts: dict[str, Any]) -> None:
    """Write facts as JSON."""
    path.write_text(json.dumps(facts, indent=2, allow_nan=False) + "\n")


def common_facts(bound: BoundField) -> dict[str, Any]:
    """What every file of a bound field says: units, frame, subject, gaze, weights, versions."""
    libraries = {name: _version(name) for name in ("trimesh", "pyvista", "numpy", "torch")}
    return {
        "units": "metres",
        "frame": "right-handed, Y up, face toward +Z, +X toward the subject's left",
        "metres_per_world_unit": bound.metres_per_unit,
        "subject": bound.subject.name,
        "gaze_pitch_yaw_degrees": list(bound.gaze.degrees),
        "weights_sha256_16": bound.weights_hash,
        "versions": {"gazenerf": __version__, **libraries},
    }


def sidecar(extracted: PartMesh, bound: BoundField) -> dict[str, Any]:
    """What a mesh file is: frame, units, threshold, resolution, subject, gaze, weights, versions."""
    mesh, threshold = extracted.mesh, extracted.threshold
    metres = bound.metres_per_unit
    return common_facts(bound) | {
        "part": extracted.part,
        "threshold_per_world_unit": threshold.level,
        "threshold_choice": threshold.how,
        "depth_disagreement_mm": None if np.isnan(threshold.depth_error_mm) else threshold.depth_error_mm,
        "thresholds_tried": [{"level": level, "depth_disagreement_mm": error} for level, error in threshold.tried],
        "grid": list(extracted.grid),
        "voxel_mm": extracted.spacing * metres * 1000.0,
        "field_queries": extracted.queries,
        "steps": list(extracted.steps),
        "vertices": len(mesh.vertices),
        "faces": len(mesh.faces),
        "watertight": bool(mesh.is_watertight),
        "bounds_metres": (np.asarray(mesh.bounds) * metres).tolist(),
    }


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "absent"
