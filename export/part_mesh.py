"""From a bound field to a clean, coloured or textured mesh of one of its parts."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache, partial

import numpy as np
import trimesh

from gazenerf.errors import UserError
from gazenerf.export.appearance.colours import blend_colours, part_pictures, with_vertex_colours
from gazenerf.export.appearance.points import PointCloud, sample_points
from gazenerf.export.appearance.texture import TexturedMesh, bake_texture
from gazenerf.export.mesh.cleaning import Cleaning
from gazenerf.export.mesh.normals import vertex_normals
from gazenerf.export.mesh.repair import self_intersections
from gazenerf.export.options import MeshOptions
from gazenerf.export.surface.coverage import Coverage, RenderedDepth, coverage
from gazenerf.export.surface.densities import DensityGrid, grid_shape, sample_density
from gazenerf.export.surface.density_surface import KEPT_COMPONENTS, Surface, density_surface, part_box
from gazenerf.export.surface.fusion import fused_surface
from gazenerf.export.surface.known_surface import with_known_surface
from gazenerf.export.surface.threshold import Threshold
from gazenerf.heads.interface import PARTS, BoundField, Part
from gazenerf.progress import Progress, silent, steps_of


@dataclass(frozen=True)
class PartMesh:
    """A part's mesh and how it came to be.

    Attributes:
        part: Which volume.
        mesh: World units, vertex normals of the surface as it is written, vertex colours (V, 4) uint8 sRGB.
        threshold: The level and why, None where no level was chosen.
        grid: Points along each axis.
        spacing: World units.
        queries: Points at which the field was queried.
        coverage: What the mesh lacks of the field's rendered depth, and what it has beyond.
        steps: What was done to the mesh, in order.
        volume: Its density, world units; None where it was not kept.
        points: Points on it, world units; None where there are none.
        textured: The mesh cut along seams, with its texture; None where it was not kept.
        self_intersections: Faces that an edge of another one pierces; None where that could not be counted.
    """

    part: Part
    mesh: trimesh.Trimesh
    threshold: Threshold | None
    grid: tuple[int, ...]
    spacing: float
    queries: int
    coverage: Coverage
    steps: tuple[str, ...] = field(default_factory=tuple)
    volume: DensityGrid | None = None
    points: PointCloud | None = None
    textured: TexturedMesh | None = None
    self_intersections: int | None = None


def extract_part(
    bound: BoundField, part: Part, options: MeshOptions | None = None, *, progress: Progress = silent
) -> PartMesh:
    """The surface of one part of a bound field.

    The surface is found, small pieces are dropped, it is cleaned, held against the field's rendered depth, and
    normals and colours are added. Python warns where much of what the field shows is missing.

    Args:
        bound: What is meshed.
        part: Which volume.
        options: How; its `parts`, `formats` and `rig` do not matter here, `volumes` decides whether the density of
            every grid point is kept.
        progress: Told about stages.

    Raises:
        UserError: unknown part, impossible setting, an empty volume, or no surface at the threshold.
    """
    options = options or MeshOptions()
    if part not in PARTS:
        raise UserError(f"unknown part {part!r}; there are {', '.join(PARTS)}")
    options.check()
    options = options.settled(part, bound.surface_spread is not None and options.surface == "isosurface")
    assert options.resolution is not None and options.smoothing is not None
    cleaning = Cleaning(
        KEPT_COMPONENTS[part],
        options.smoothing,
        options.max_faces,
        holes=options.holes_mm / (1000.0 * bound.metres_per_unit),
        seen=options.seen,
        repair=options.repair,
    )
    resolution, volume = options.resolution, bool(options.volumes)
    bound = with_known_surface(bound, part)
    grid_shape(bound.box, resolution)
    rendered = cache(partial(RenderedDepth.of, bound, part))
    if options.surface == "isosurface":
        found = density_surface(
            bound,
            part,
            resolution=resolution,
            threshold=options.threshold,
            method=options.method,
            dense=volume,
            rendered=rendered,
            progress=progress,
        )
        kept = found.volume
    else:
        found = fused_surface(bound, part, options.surface, resolution=resolution, progress=progress)
        kept = None
        if volume:
            told = steps_of(progress, f"{part} density")
            kept = sample_density(bound, part, part_box(bound, part)[0], resolution, told)
    return _finished(bound, part, found, cleaning, options, kept, rendered, progress)


def _finished(
    bound: BoundField,
    part: Part,
    found: Surface,
    cleaning: Cleaning,
    options: MeshOptions,
    volume: DensityGrid | None,
    rendered: Callable[[], RenderedDepth],
    progress: Progress,
) -> PartMesh:
    """A found surface cleaned, with normals, colours and what else was asked for."""
    mesh = cleaning.apply(found.mesh)
    steps = [*found.steps, *cleaning.steps(), "angle-weighted normals of the surface"]
    normals = vertex_normals(mesh)
    mesh = trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_normals=normals, process=False)
    progress(f"{part} against rendered depth", 0, 1)
    covered = coverage(mesh, rendered())
    if (warning := covered.warning(part)) is not None:
        warnings.warn(warning, stacklevel=3)
    pictures, cloud, textured = None, None, None
    if options.colours or options.texture is not None:
        progress(f"{part} pictures", 0, 1)
        pictures = part_pictures(bound, part)
    if pictures is not None and options.colours:
        rgb, seen = blend_colours(pictures, mesh, np.asarray(mesh.vertices), normals)
        mesh = with_vertex_colours(mesh, rgb)
        steps.append(f"vertex colours from rendered views ({seen.mean():.0%} of the vertices seen)")
    if options.points is not None:
        progress(f"{part} points", 0, 1)
        cloud = sample_points(mesh, options.points, pictures if options.colours else None)
    if pictures is not None and options.texture is not None:
        progress(f"{part} texture", 0, 1)
        textured = bake_texture(mesh, pictures, options.texture)
        steps.append(f"texture of {options.texture} from rendered views ({textured.seen:.0%} of the texels seen)")
    return PartMesh(
        part,
        mesh,
        found.threshold,
        found.grid,
        found.spacing,
        found.queries,
        covered,
        tuple(steps),
        volume,
        cloud,
        textured,
        self_intersections(mesh),
    )
