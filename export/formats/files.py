"""Mesh files in metres with a sidecar that says what they are."""

from __future__ import annotations

import json
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from gazenerf import __version__
from gazenerf.export.appearance.colours import vertex_colours
from gazenerf.export.appearance.points import write_points
from gazenerf.export.appearance.texture import TexturedMesh
from gazenerf.export.formats.gltf import glb
from gazenerf.export.formats.nodes import Node, Texture
from gazenerf.export.formats.obj import material, textured_obj
from gazenerf.export.formats.usd import usdz
from gazenerf.export.formats.volumes import write_volume
from gazenerf.export.options import MeshOptions
from gazenerf.export.part_mesh import PartMesh
from gazenerf.export.surface.coverage import Coverage
from gazenerf.heads.interface import BoundField
from gazenerf.options import to_dict

Facts = dict[str, Any]
"""What a sidecar says, as JSON holds it."""


@dataclass(frozen=True)
class WrittenPart:
    """What was written of one part.

    Attributes:
        extracted: Its mesh and how it came to be.
        files: Kind to file.
        facts: What its sidecar says.
    """

    extracted: PartMesh
    files: dict[str, Path]
    facts: Facts

    @property
    def mesh(self) -> trimesh.Trimesh:
        """World units."""
        return self.extracted.mesh


def in_metres(mesh: trimesh.Trimesh, metres_per_unit: float) -> trimesh.Trimesh:
    """The same mesh scaled to metres, normals and colours kept."""
    return trimesh.Trimesh(
        np.asarray(mesh.vertices) * metres_per_unit,
        mesh.faces,
        vertex_normals=mesh.vertex_normals,
        vertex_colors=vertex_colours(mesh),
        process=False,
    )


def part_files(part: str, options: MeshOptions) -> dict[str, str]:
    """What is written for one part: kind to file name."""
    names = {kind: f"{part}.{kind}" for kind in options.formats}
    if options.texture is not None and "obj" in options.formats:
        names |= {"mtl": f"{part}.mtl", "png": f"{part}.png"}
    if options.points is not None:
        names["points"] = f"{part}-points.ply"
    names |= {kind: f"{part}.{kind}" for kind in options.volumes}
    return names | {"json": f"{part}.json"}


def write_part(
    extracted: PartMesh,
    bound: BoundField,
    folder: Path,
    options: MeshOptions,
    measured: Facts | None = None,
) -> Facts:
    """Write what there is of one part, and its sidecar, to an existing folder.

    Args:
        extracted: The part.
        bound: What it was extracted from.
        folder: Where.
        options: Which formats.
        measured: More for the sidecar.

    Returns:
        What the sidecar says.
    """
    formats = options.formats
    metres, name = bound.metres_per_unit, extracted.part
    mesh = in_metres(extracted.mesh, metres)
    png = None if extracted.textured is None else extracted.textured.png()
    for kind in formats:
        path = folder / f"{name}.{kind}"
        if kind == "glb":
            path.write_bytes(glb(_node(extracted, mesh, metres, png), compressed=options.compress))
        elif kind == "usdz":
            path.write_bytes(usdz(_node(extracted, mesh, metres, png)))
        elif kind == "ply":
            mesh.export(path, file_type="ply", vertex_normal=True)
        elif kind == "stl":  # slicers read its numbers as millimetres
            trimesh.Trimesh(1000.0 * mesh.vertices, mesh.faces, process=False).export(path, file_type="stl")
        elif extracted.textured is not None and png is not None:
            cut = in_metres(extracted.textured.mesh, metres)
            path.write_text(textured_obj(cut, extracted.textured.uv, name), encoding="ascii")
            (folder / f"{name}.mtl").write_text(material(name), encoding="ascii")
            (folder / f"{name}.png").write_bytes(png)
        else:
            mesh.export(path, file_type="obj", include_normals=True, include_color=True)
    if extracted.points is not None:
        write_points(extracted.points, metres, folder / f"{name}-points.ply")
    if extracted.volume is not None:
        for kind in options.volumes:
            write_volume(extracted.volume, metres, kind, folder / f"{name}.{kind}")
    about = sidecar(extracted, bound) | (measured or {}) | {"options": to_dict(options, MeshOptions)}
    if "stl" in formats:
        about["stl_units"] = "millimetres"
    write_sidecar(folder / f"{name}.json", about)
    return about


def _node(extracted: PartMesh, mesh: trimesh.Trimesh, metres: float, png: bytes | None) -> Node:
    if extracted.textured is None or png is None:
        return Node(extracted.part, mesh)
    return textured_node(extracted.part, extracted.textured, metres, png)


def textured_node(name: str, textured: TexturedMesh, metres_per_unit: float, png: bytes | None = None) -> Node:
    """A textured mesh, world units, as a node in metres."""
    mesh = in_metres(textured.mesh, metres_per_unit)
    return Node(name, mesh, texture=Texture(textured.uv, textured.png() if png is None else png))


def write_sidecar(path: Path, facts: Facts) -> None:
    """Write facts as JSON."""
    path.write_text(json.dumps(facts, indent=2, allow_nan=False) + "\n")


def common_facts(bound: BoundField) -> Facts:
    """What every file of a bound field says: units, frame, subject, gaze, weights, versions."""
    libraries = {name: _version(name) for name in ("trimesh", "pyvista", "numpy", "torch")}
    return {
        "units": "metres",
        "frame": "right-handed, Y up, face toward +Z, +X toward the subject's left",
        "metres_per_world_unit": bound.metres_per_unit,
        "subject": bound.subject.name,
        "fitted_to": bound.subject.fitted_to,
        "gaze_pitch_yaw_degrees": list(bound.gaze.degrees),
        "weights_sha256_16": bound.weights_hash,
        "versions": {"gazenerf": __version__, **libraries},
    }


def sidecar(extracted: PartMesh, bound: BoundField) -> Facts:
    """What a part's files are: frame, units, threshold, resolution, subject, gaze, weights, versions."""
    mesh, threshold = extracted.mesh, extracted.threshold
    metres = bound.metres_per_unit
    level: Facts = {"threshold_per_world_unit": None, "threshold_choice": None}
    if threshold is not None:
        level = {
            "threshold_per_world_unit": threshold.level,
            "threshold_choice": threshold.how,
            "thresholds_tried": [{"level": found.level} | coverage_facts(found.coverage) for found in threshold.tried],
        }
    covered = extracted.coverage
    lost = [
        {"area_cm2": part.area_cm2, "centre_metres": (metres * part.centre).tolist(), "where": part.where}
        for part in covered.lost
    ]
    facts = common_facts(bound) | {
        "part": extracted.part,
        **level,
        **coverage_facts(covered),
        "lost_parts": lost,
        "grid": list(extracted.grid),
        "voxel_mm": extracted.spacing * metres * 1000.0,
        "field_queries": extracted.queries,
        "steps": list(extracted.steps),
        "vertices": len(mesh.vertices),
        "faces": len(mesh.faces),
        "watertight": bool(mesh.is_watertight),
        "components": int(mesh.body_count),
        "self_intersecting_faces": extracted.self_intersections,
        "bounds_metres": (np.asarray(mesh.bounds) * metres).tolist(),
    }
    if extracted.volume is not None:
        grid = extracted.volume
        facts["volume"] = {
            "density": "per metre; 1 - exp(-density d) is the opacity over d metres",
            "points": list(grid.values.shape),
            "origin_metres": (grid.origin * metres).tolist(),
            "spacing_metres": grid.spacing * metres,
        }
    if extracted.points is not None:
        facts["points_on_the_surface"] = len(extracted.points.points)
    if extracted.textured is not None:
        textured = extracted.textured
        facts["texture"] = {
            "size": len(textured.image),
            "charts": textured.charts,
            "share_covered_by_charts": textured.covered,
            "share_of_texels_seen": textured.seen,
            "vertices_with_seams": len(textured.mesh.vertices),
        }
    return facts


def coverage_facts(found: Coverage) -> Facts:
    """A mesh against its field's rendered depth, as sidecars say it."""
    return {
        "depth_disagreement_mm": None if np.isnan(found.depth_error_mm) else found.depth_error_mm,
        "share_of_rendered_depth_missing": found.missing,
        "share_of_surface_not_rendered": found.unrendered,
    }


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "absent"
