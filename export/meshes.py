"""From a bound field to clean, coloured meshes of its parts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import numpy as np
import trimesh

from export.colours import bake_vertex_colours
from export.densities import DensityGrid, fill_enclosed, refine_density
from export.files import FORMATS, write_mesh
from export.isosurface import isosurface
from export.normals import density_normals
from export.threshold import CANDIDATES, Threshold, choose_threshold
from gazenerf.errors import UserError
from gazenerf.field.interface import BoundField, Part
from gazenerf.files import whole_folder

KEPT_COMPONENTS = {"face": 1, "eyes": 2, "head": 3}
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
    colours: bool = True,
    progress: Callable[[str, int, int], None] | None = None,
) -> PartMesh:
    """The surface of one part of a bound field.

    The density is sampled coarse to fine, the threshold chosen, what is enclosed made solid (face
    and head), small pieces dropped, normals and colours added.

    Args:
        resolution: Grid points along the longest side of the field's box.
        threshold: `auto`, a density, or a percentile such as `p50`.
        colours: Bake vertex colours from rendered views.
        progress: Called with (stage, done, total).

    Raises:
        UserError: unknown part, impossible resolution, or no surface at the threshold.
    """
    if part not in MESH_PARTS:
        raise UserError(f"unknown part {part!r}; there are {', '.join(MESH_PARTS)}")
    fixed = None if isinstance(threshold, str) else float(threshold)
    levels = (CANDIDATES[0], CANDIDATES[-1]) if fixed is None or not np.isfinite(fixed) else (fixed, fixed)
    if isinstance(threshold, str) and threshold.startswith("p"):
        levels = (1e-3, np.inf)

    def told(stage: str) -> Callable[[int, int], None] | None:
        if progress is None:
            return None
        tell = progress
        return lambda done, total: tell(stage, done, total)

    box = _part_box(bound, part)
    grid = refine_density(bound, part, box, resolution, levels, progress=told(f"{part} density"))
    steps = ["coarse-to-fine density"]
    other: DensityGrid | None = None
    if part == "face":
        other = _other_volume(bound, box, resolution, levels)

    @cache
    def volume(level: float) -> DensityGrid:
        return grid if part == "eyes" else fill_enclosed(grid, other, level)

    def surface(level: float) -> trimesh.Trimesh:
        return keep_largest(isosurface(volume(level), level), KEPT_COMPONENTS[part])

    chosen = choose_threshold(bound, part, grid, threshold, surface)
    mesh = surface(chosen.level)
    if part != "eyes":
        steps.append("enclosed space filled")
    steps += ["flying edges", f"largest {KEPT_COMPONENTS[part]} component(s) kept"]
    normals = density_normals(bound, np.asarray(mesh.vertices), part, 0.5 * grid.spacing, mesh.vertex_normals)
    mesh = trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_normals=normals, process=False)
    steps.append("normals from the density gradient")
    if colours:
        rgb, seen = bake_vertex_colours(bound, mesh, part)
        rgba = np.concatenate([rgb, np.full((len(rgb), 1), 255, np.uint8)], axis=1)
        mesh = trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_normals=normals, vertex_colors=rgba, process=False)
        steps.append(f"vertex colours from rendered views ({seen:.0%} of the vertices seen)")
    return PartMesh(
        part,
        mesh,
        chosen,
        grid.values.shape,
        grid.spacing,
        grid.queries + (other.queries if other else 0),
        tuple(steps),
    )


def _part_box(bound: BoundField, part: Part) -> np.ndarray:
    """The field's box; for the eyes the smallest box around their density, so that it is sampled finely."""
    if part != "eyes":
        return bound.box
    probe = refine_density(bound, "eyes", bound.box, 64, (0.5, np.inf))
    found = np.argwhere(probe.values > 0.5)
    if not len(found):
        raise UserError("the eyes volume is empty; train longer or export --parts face")
    margin = 2 * probe.spacing
    return np.stack(
        [probe.origin + probe.spacing * found.min(0) - margin, probe.origin + probe.spacing * found.max(0) + margin]
    )


def _other_volume(
    bound: BoundField, box: np.ndarray, resolution: int, levels: tuple[float, float]
) -> DensityGrid | None:
    try:
        return refine_density(bound, "eyes", box, resolution, levels)
    except UserError:
        return None


def keep_largest(mesh: trimesh.Trimesh, count: int) -> trimesh.Trimesh:
    """The `count` connected components with the largest enclosed volume, as one mesh."""
    pieces = mesh.split(only_watertight=False)
    if len(pieces) <= count:
        return mesh
    order = sorted(pieces, key=lambda piece: abs(float(piece.volume)), reverse=True)[:count]
    kept = trimesh.util.concatenate(order)
    assert isinstance(kept, trimesh.Trimesh)
    return kept


def mesh_subject(
    bound: BoundField,
    out: str | Path,
    *,
    parts: tuple[Part, ...] = ("face", "eyes"),
    resolution: int = 192,
    threshold: str | float = "auto",
    formats: tuple[str, ...] = ("glb", "ply", "obj"),
    colours: bool = True,
    overwrite: bool = False,
    progress: Callable[[str, int, int], None] | None = None,
) -> dict[str, PartMesh]:
    """Extract parts and write them to a folder: `PART.FORMAT` and one `PART.json` each.

    Files are in metres, Y up, face toward +Z. Nothing is written unless everything succeeds.

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
    taken = [
        out / f"{part}.{kind}" for part in parts for kind in (*formats, "json") if (out / f"{part}.{kind}").exists()
    ]
    if taken and not overwrite:
        raise UserError(f"{taken[0]} exists; add --overwrite or choose another --out")
    meshes = {
        part: extract_part(bound, part, resolution=resolution, threshold=threshold, colours=colours, progress=progress)
        for part in parts
    }
    with whole_folder(out) as folder:
        for extracted in meshes.values():
            write_mesh(extracted, bound, folder, formats)
    return dict(meshes)
