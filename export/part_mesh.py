"""From a bound field to a clean, coloured or textured mesh of one of its parts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import trimesh

from gazenerf.errors import UserError
from gazenerf.export.appearance.colours import blend_colours, part_pictures, with_vertex_colours
from gazenerf.export.appearance.points import PointCloud, check_points, sample_points
from gazenerf.export.appearance.texture import MAX_FACES, TexturedMesh, bake_texture, check_texture
from gazenerf.export.mesh.cleaning import Cleaning
from gazenerf.export.mesh.repair import self_intersections
from gazenerf.export.surface.densities import DensityGrid, grid_shape, sample_density
from gazenerf.export.surface.density_surface import KEPT_COMPONENTS, Surface, density_surface, part_box
from gazenerf.export.surface.fusion import SURFACES, fused_surface
from gazenerf.export.surface.normals import density_normals
from gazenerf.export.surface.threshold import Threshold
from gazenerf.heads.interface import BoundField, Part

MESH_PARTS: tuple[Part, ...] = ("face", "eyes", "head")


@dataclass(frozen=True)
class PartMesh:
    """A part's mesh and how it came to be.

    Attributes:
        part: Which volume.
        mesh: World units, vertex normals from the density gradient, vertex colours (V, 4) uint8 sRGB.
        threshold: The level and why, None where no level was chosen.
        grid: Points along each axis.
        spacing: World units.
        queries: Points the field was asked for.
        steps: What was done to the mesh, in order.
        volume: Its density, world units; None where it was not asked for.
        points: Points on it, world units; None where they were not asked for.
        textured: The mesh cut along seams, with its texture; None where it was not asked for.
        self_intersections: Faces that an edge of another one pierces; None where that could not be counted.
    """

    part: Part
    mesh: trimesh.Trimesh
    threshold: Threshold | None
    grid: tuple[int, ...]
    spacing: float
    queries: int
    steps: tuple[str, ...] = field(default_factory=tuple)
    volume: DensityGrid | None = None
    points: PointCloud | None = None
    textured: TexturedMesh | None = None
    self_intersections: int | None = None


def extract_part(
    bound: BoundField,
    part: Part,
    *,
    resolution: int = 192,
    threshold: str | float = "auto",
    method: str = "flying-edges",
    surface: str = "isosurface",
    repair: bool = False,
    seen: bool = False,
    holes_mm: float = 0.0,
    smoothing: int = 0,
    max_faces: int | None = None,
    colours: bool = True,
    texture: int | None = None,
    points: int | None = None,
    volume: bool = False,
    progress: Callable[[str, int, int], None] | None = None,
) -> PartMesh:
    """The surface of one part of a bound field.

    The surface is found, small pieces are dropped, it is cleaned, and normals and colours are added.

    Args:
        resolution: Grid points along the longest side of the part's box.
        threshold: `auto`, a density, or a percentile such as `p50`; isosurfaces only.
        method: One of `gazenerf.export.surface.isosurface.METHODS`; isosurfaces only.
        surface: One of `gazenerf.export.surface.fusion.SURFACES`.
        repair: Make the surface manifold.
        seen: Drop pieces that cannot be seen from outside.
        holes_mm: Close holes up to this radius, millimetres.
        smoothing: Rounds of Taubin smoothing.
        max_faces: Decimate to at most so many faces; `gazenerf.export.appearance.texture.MAX_FACES` where None and a
            texture is asked for.
        colours: Bake vertex colours from rendered views.
        texture: Bake a texture of so many texels along a side, too.
        points: Sample so many points on the surface, too.
        volume: Keep the density of every grid point.
        progress: Called with (stage, done, total).

    Raises:
        UserError: unknown part, impossible setting, an empty volume, or no surface at the threshold.
    """
    if part not in MESH_PARTS:
        raise UserError(f"unknown part {part!r}; there are {', '.join(MESH_PARTS)}")
    if surface not in SURFACES:
        raise UserError(f"unknown surface {surface!r}; there are {', '.join(SURFACES)}")
    if points is not None:
        check_points(points)
    if texture is not None:
        check_texture(texture)
        max_faces = MAX_FACES if max_faces is None else max_faces
    cleaning = Cleaning(
        KEPT_COMPONENTS[part],
        smoothing,
        max_faces,
        holes=holes_mm / (1000.0 * bound.metres_per_unit),
        seen=seen,
        repair=repair,
    )
    grid_shape(bound.box, resolution)

    def tell(stage: str, done: int, total: int) -> None:
        if progress is not None:
            progress(stage, done, total)

    if surface == "isosurface":
        found = density_surface(
            bound, part, resolution=resolution, threshold=threshold, method=method, dense=volume, tell=tell
        )
        kept = found.volume
    else:
        found = fused_surface(bound, part, surface, resolution=resolution, tell=tell)
        kept = None
        if volume:
            told = lambda done, total: tell(f"{part} density", done, total)  # noqa: E731
            kept = sample_density(bound, part, part_box(bound, part)[0], resolution, told)
    return _finished(bound, part, found, cleaning, colours, texture, points, kept, tell)


def _finished(
    bound: BoundField,
    part: Part,
    found: Surface,
    cleaning: Cleaning,
    colours: bool,
    texture: int | None,
    points: int | None,
    volume: DensityGrid | None,
    tell: Callable[[str, int, int], None],
) -> PartMesh:
    """A found surface cleaned, with normals, colours and what else was asked for."""
    mesh = cleaning.apply(found.mesh)
    steps = [*found.steps, *cleaning.steps(), "normals from the density gradient"]
    normals = density_normals(bound, np.asarray(mesh.vertices), part, 0.5 * found.spacing, mesh.vertex_normals)
    mesh = trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_normals=normals, process=False)
    pictures, cloud, textured = None, None, None
    if colours or texture is not None:
        tell(f"{part} pictures", 0, 1)
        pictures = part_pictures(bound, part)
    if pictures is not None and colours:
        rgb, seen = blend_colours(pictures, mesh, np.asarray(mesh.vertices), normals)
        mesh = with_vertex_colours(mesh, rgb)
        steps.append(f"vertex colours from rendered views ({seen.mean():.0%} of the vertices seen)")
    if points is not None:
        tell(f"{part} points", 0, 1)
        cloud = sample_points(mesh, points, pictures if colours else None)
    if pictures is not None and texture is not None:
        tell(f"{part} texture", 0, 1)
        textured = bake_texture(mesh, pictures, texture)
        steps.append(f"texture of {texture} from rendered views ({textured.seen:.0%} of the texels seen)")
    return PartMesh(
        part,
        mesh,
        found.threshold,
        found.grid,
        found.spacing,
        found.queries,
        tuple(steps),
        volume,
        cloud,
        textured,
        self_intersections(mesh),
    )
