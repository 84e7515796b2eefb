"""From a bound field to clean, coloured meshes of its parts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
import trimesh

from export.cleaning import Cleaning, keep_largest
from export.colours import bake_vertex_colours
from export.densities import DensityGrid, fill_enclosed, grid_shape
from export.files import FORMATS, common_facts, write_mesh, write_sidecar
from export.isosurface import isosurface
from export.normals import density_normals
from export.refine import refine_density
from export.rig import rig
from export.threshold import CANDIDATES, Threshold, choose_threshold
from gazenerf.errors import UserError
from gazenerf.field.interface import BoundField, Part
from gazenerf.files import whole_folder
from gazenerf.geometry import Gaze

KEPT_COMPONENTS = {"face": 1, "eyes": 2, "head": 3}
JUDGING_RESOLUTION = 96
"""Grid points along the longest side while a threshold is chosen."""

MESH_PARTS: tuple[Part, ...] = ("face", "eyes", "head")


@dataclass(frozen=True)
class PartMesh:
    """A part's mesh and how it came to be.

    Attributes:
        part: Which volume.
        mesh: World units, vertex normals from the density gradient, vertex colours (V, 4) uint8 sRGB.
        threshold: The level and why.
        grid: Points along each axis.
        spacing: World units.
        queries: Points the field was asked for.
        steps: What was done to the mesh, in order.
    """

    part: Part
    mesh: trimesh.Trimesh
    threshold: Threshold
    grid: tuple[int, ...]
    spacing: float
    queries: int
    steps: tuple[str, ...] = field(default_factory=tuple)


def extract_part(
    bound: BoundField,
    part: Part,
    *,
    resolution: int = 192,
    threshold: str | float = "auto",
    method: str = "flying-edges",
    smoothing: int = 0,
    max_faces: int | None = None,
    colours: bool = True,
    progress: Callable[[str, int, int], None] | None = None,
) -> PartMesh:
    """The surface of one part of a bound field.

    The threshold is chosen on a grid of at most `JUDGING_RESOLUTION`, the density sampled along that
    level's surface, what is enclosed made solid (face and head), small pieces dropped, the surface
    cleaned, normals and colours added.

    Args:
        resolution: Grid points along the longest side of the field's box.
        threshold: `auto`, a density, or a percentile such as `p50`.
        method: One of `export.isosurface.METHODS`.
        smoothing: Rounds of Taubin smoothing.
        max_faces: Decimate to at most so many faces.
        colours: Bake vertex colours from rendered views.
        progress: Called with (stage, done, total).

    Raises:
        UserError: unknown part, impossible resolution, or no surface at the threshold.
    """
    if part not in MESH_PARTS:
        raise UserError(f"unknown part {part!r}; there are {', '.join(MESH_PARTS)}")
    cleaning = Cleaning(KEPT_COMPONENTS[part], smoothing, max_faces)
    grid_shape(bound.box, resolution)

    def told(stage: str) -> Callable[[int, int], None] | None:
        if progress is None:
            return None
        tell = progress
        return lambda done, total: tell(stage, done, total)

    box, queries = _part_box(bound, part)

    def volumes(side: int, levels: tuple[float, float]) -> tuple[DensityGrid, DensityGrid | None]:
        own = refine_density(bound, part, box, side, levels, progress=told(f"{part} density"))
        return own, refine_density(bound, "eyes", box, side, levels) if part == "face" and has_eyes(bound) else None

    level = _fixed_level(threshold)
    if level is not None:
        chosen = Threshold(level, "fixed")
    else:
        judged, beside = volumes(min(resolution, JUDGING_RESOLUTION), _judged_levels(threshold))
        queries += judged.queries + (beside.queries if beside else 0)

        def candidate(level: float) -> trimesh.Trimesh:
            solid = judged if part == "eyes" else fill_enclosed(judged, beside, level)
            return keep_largest(isosurface(solid, level, method), KEPT_COMPONENTS[part])

        chosen = choose_threshold(bound, part, judged, threshold, candidate)
    grid, other = volumes(resolution, (chosen.level, chosen.level))
    queries += grid.queries + (other.queries if other else 0)
    solid = grid if part == "eyes" else fill_enclosed(grid, other, chosen.level)
    mesh = cleaning.apply(isosurface(solid, chosen.level, method))
    steps = ["coarse-to-fine density", *(() if part == "eyes" else ("enclosed space filled",))]
    steps += [method.replace("-", " "), *cleaning.steps()]
    normals = density_normals(bound, np.asarray(mesh.vertices), part, 0.5 * grid.spacing, mesh.vertex_normals)
    mesh = trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_normals=normals, process=False)
    steps.append("normals from the density gradient")
    if colours:
        rgb, seen = bake_vertex_colours(bound, mesh, part)
        rgba = np.concatenate([rgb, np.full((len(rgb), 1), 255, np.uint8)], axis=1)
        mesh = trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_normals=normals, vertex_colors=rgba, process=False)
        steps.append(f"vertex colours from rendered views ({seen:.0%} of the vertices seen)")
    return PartMesh(part, mesh, chosen, grid.values.shape, grid.spacing, queries, tuple(steps))


def _fixed_level(threshold: str | float) -> float | None:
    """A threshold that needs no judging."""
    try:
        return float(threshold)
    except ValueError:
        return None


def _judged_levels(threshold: str | float) -> tuple[float, float]:
    return (CANDIDATES[0], CANDIDATES[-1]) if threshold == "auto" else (1e-3, np.inf)


def has_eyes(bound: BoundField) -> bool:
    """Whether the field has an eyes volume of its own."""
    try:
        bound.density(torch.zeros(1, 3), "eyes")
    except UserError:
        return False
    return True


def _part_box(bound: BoundField, part: Part) -> tuple[np.ndarray, int]:
    """The field's box; for the eyes the smallest box around their density, so that it is sampled finely.

    Also how many points that took.
    """
    if part != "eyes":
        return bound.box, 0
    probe = refine_density(bound, "eyes", bound.box, 64, (0.5, np.inf))
    found = np.argwhere(probe.values > 0.5)
    if not len(found):
        raise UserError("the eyes volume is empty; train longer or export --parts face")
    margin = 2 * probe.spacing
    corners = probe.origin + probe.spacing * np.stack([found.min(0), found.max(0)])
    return corners + np.array([[-margin], [margin]]), probe.queries


def mesh_subject(
    bound: BoundField,
    out: str | Path,
    *,
    parts: tuple[Part, ...] = ("face", "eyes"),
    resolution: int = 192,
    threshold: str | float = "auto",
    formats: tuple[str, ...] = ("glb", "ply", "obj"),
    colours: bool = True,
    method: str = "flying-edges",
    smoothing: int = 0,
    max_faces: int | None = None,
    bind: Callable[[Gaze], BoundField] | None = None,
    overwrite: bool = False,
    progress: Callable[[str, int, int], None] | None = None,
) -> dict[str, PartMesh]:
    """Extract parts and write them to a folder: `PART.FORMAT` and one `PART.json` each.

    Files are in metres, Y up, face toward +Z. Nothing is written unless everything succeeds.

    Args:
        bound: What is meshed.
        out: Folder.
        parts: Some of face, eyes, head.
        formats: Some of glb, ply, obj.
        bind: Binds the same subject to other gazes; given, `rig.glb` with turning eyes is written too.
        overwrite: Replace files of these names.
        resolution, threshold, colours, method, smoothing, max_faces, progress: See `extract_part`.

    Returns:
        Part to its mesh, in world units.

    Raises:
        UserError: see `extract_part`; also unknown formats and existing files without `overwrite`.
    """
    if unknown := sorted(set(formats) - set(FORMATS)):
        raise UserError(f"unknown format {unknown[0]!r}; there are {', '.join(FORMATS)}")
    if not parts or not formats:
        raise UserError("give at least one part and one format")
    out = Path(out)
    if bind is not None and not {"face", "eyes"} <= set(parts):
        raise UserError("the rig needs --parts face eyes")
    names = [f"{part}.{kind}" for part in parts for kind in (*formats, "json")]
    names += ["rig.glb", "rig.json"] if bind is not None else []
    taken = [out / name for name in names if (out / name).exists()]
    if taken and not overwrite:
        raise UserError(f"{taken[0]} exists; add --overwrite or choose another --out")
    meshes = {
        part: extract_part(
            bound,
            part,
            resolution=resolution,
            threshold=threshold,
            method=method,
            smoothing=smoothing,
            max_faces=max_faces,
            colours=colours,
            progress=progress,
        )
        for part in parts
    }
    if progress is not None and bind is not None:
        progress("rig", 0, 1)
    rigged = None if bind is None else rig(bind, bound.gaze, meshes["face"].mesh, meshes["eyes"].mesh)
    with whole_folder(out) as folder:
        for extracted in meshes.values():
            write_mesh(extracted, bound, folder, formats)
        if rigged is not None:
            (folder / "rig.glb").write_bytes(rigged[0])
            write_sidecar(folder / "rig.json", common_facts(bound) | {"part": "rig"} | rigged[1])
    return dict(meshes)
