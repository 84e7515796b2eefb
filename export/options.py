"""Every setting of a mesh, once; presets are what differs for a use."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Self

from gazenerf.errors import UserError
from gazenerf.export.appearance.points import check_points
from gazenerf.export.appearance.texture import MAX_FACES, SIZES, check_texture
from gazenerf.export.surface.fusion import SURFACES
from gazenerf.export.surface.isosurface import METHODS
from gazenerf.heads.interface import PARTS, Part
from gazenerf.options import option

FORMATS = ("glb", "ply", "obj", "stl", "usdz")

SMOOTHED = 40
"""Rounds of smoothing of surfaces that are not those of signed distances."""

RESOLUTION, FINE_RESOLUTION = 192, 320
"""Grid points along the longest side; the second of face and head where their surface is that of signed distances: lips
and lids are then wider than the grid's cells."""

FINE_FACES = 150_000
"""What a surface of `FINE_RESOLUTION` is reduced to, about as many triangles as one of `RESOLUTION` has."""

TEXTURED = ("glb", "obj", "usdz")
"""Formats that carry a texture."""

VOLUMES = ("nrrd", "vti", "npz")
"""Formats of densities."""

SURFACE, WRITTEN = "surface", "what is written"

PRESETS: dict[str, dict[str, Any]] = {
    "blender": {"formats": ("glb", "obj"), "max_faces": 50_000, "texture": 2048, "rig": True},
    "web": {
        "formats": ("glb",),
        "max_faces": 15_000,
        "texture": 1024,
        "rig": True,
        "page": True,
    },
    "print": {
        "parts": ("head",),
        "formats": ("stl", "ply"),
        "resolution": 256,
        "repair": True,
        "seen": True,
    },
    "research": {
        "formats": ("ply",),
        "resolution": RESOLUTION,
        "smoothing": 0,
        "points": 200_000,
        "volumes": ("nrrd", "npz"),
    },
}
"""Use to the settings that differ from the defaults."""


@dataclass(frozen=True, kw_only=True)
class MeshOptions:
    """How parts of a head become meshes, and what is written of them.

    Attributes:
        parts: Some of face, eyes, head.
        resolution: Grid points along the longest side of a part's box; see `settled` where None.
        threshold: Density of the surface: `auto`, a number per world unit, or a percentile such as `p50`.
        surface: `isosurface` of the density; `tsdf` or `poisson`, of depth in pictures all around.
        method: How an isosurface is extracted.
        repair: Make the surface manifold.
        seen: Drop pieces that cannot be seen from outside.
        holes_mm: Close holes up to this radius, millimetres; inf for all.
        smoothing: Rounds of Taubin smoothing, which keeps the volume; see `settled` where None.
        max_faces: Decimate each part to at most so many triangles; see `settled` where None.
        formats: Some of glb, ply, obj, stl (millimetres), usdz.
        colours: Colour the vertices from rendered views.
        texture: Texels along a side of a texture, carried by glb, obj, usdz and the rig; none where None.
        points: Also write so many coloured points of each surface.
        volumes: Also write the densities, some of nrrd, vti, npz.
        rig: Also write one file whose eyes turn.
        page: Also write `index.html`, which shows the rig in any browser; the rig is written with it.
        clip: The rig has a clip that shows it.
        compress: Write GLBs with 16-bit positions, 8-bit normals and WebP textures.
    """

    parts: tuple[Part, ...] = option(("face", "eyes"), "face, eyes, head (default: face eyes)", metavar="PART")
    resolution: int | None = option(
        None, "grid points along the longest side (default: 192; 320 of face and head where the field has signed "
        "distances)", metavar="N", group=SURFACE,
    )  # fmt: skip
    threshold: str | float = option(
        "auto", "density of the surface: auto, a number, or p50", metavar="auto|X", group=SURFACE
    )
    surface: str = option(
        "isosurface",
        "of the density, or of depth in pictures all around: fused (tsdf), or a fitted solid (poisson)",
        choices=SURFACES,
        group=SURFACE,
    )
    method: str = option("flying-edges", "how an isosurface is extracted", choices=METHODS, group=SURFACE)
    repair: bool = option(False, "make the surface manifold", group=SURFACE)
    seen: bool = option(False, "drop pieces that cannot be seen from outside", flag="--drop-hidden", group=SURFACE)
    holes_mm: float = option(
        0.0, "close holes up to this radius; inf for all", flag="--close-holes", metavar="MM", group=SURFACE
    )
    smoothing: int | None = option(
        None, "rounds of smoothing that keeps the volume (default: 40; 0 where the field has signed distances)",
        flag="--smooth", metavar="N", group=SURFACE,
    )  # fmt: skip
    max_faces: int | None = option(
        None, "decimate each part to at most N triangles (default: 20,000 with a texture, 150,000 at the finer of the "
        "default resolutions)", metavar="N", group=SURFACE,
    )  # fmt: skip
    formats: tuple[str, ...] = option(
        ("glb", "ply", "obj"), "glb, ply, obj, stl, usdz (default: glb ply obj)", metavar="F", group=WRITTEN
    )
    colours: bool = option(True, "leave the meshes grey", flag="--no-colours", group=WRITTEN)
    texture: int | None = option(
        None, "give glb, obj and usdz a texture of this many pixels per side", choices=SIZES, group=WRITTEN
    )
    points: int | None = option(None, "also write N coloured points of each surface", metavar="N", group=WRITTEN)
    volumes: tuple[str, ...] = option(
        (), "also write the densities: nrrd, vti, npz", flag="--volume", metavar="F", group=WRITTEN
    )
    rig: bool = option(
        False,
        "also write rig.glb, one file whose eyes turn",
        off=("--no-rig", "neither rig.glb nor index.html where --for would write them"),
        group=WRITTEN,
    )
    page: bool = option(
        False,
        "also write index.html, one file that shows the rig in any browser, without a network",
        off=("--no-page", "no index.html where --for would write one"),
        group=WRITTEN,
    )
    clip: bool = option(
        True, "no animation in the rig, which would turn the eyes back", flag="--no-clip", group=WRITTEN
    )
    compress: bool = option(
        False,
        "write GLBs less than half as large, for programs that know KHR_mesh_quantization and EXT_texture_webp",
        group=WRITTEN,
    )

    def __post_init__(self) -> None:
        for name in ("parts", "formats", "volumes"):
            object.__setattr__(self, name, tuple(dict.fromkeys(getattr(self, name))))

    @classmethod
    def uses(cls) -> tuple[str, ...]:
        """The names of the presets."""
        return tuple(PRESETS)

    @classmethod
    def preset(cls, use: str | None, /, **given: Any) -> Self:
        """Settings that fit a use; what is given beside it wins.

        Its rig is left out where the parts that it needs are not among the given ones, and its page where the rig is.

        Raises:
            UserError: unknown use.
        """
        if use is not None and use not in PRESETS:
            raise UserError(f"unknown use {use!r}; there are {', '.join(PRESETS)}")
        preset = {} if use is None else dict(PRESETS[use])
        if "parts" in given and not {"face", "eyes"} <= set(given["parts"]):
            preset.pop("rig", None)
            preset.pop("page", None)
        if given.get("rig") is False:
            preset.pop("page", None)
        return cls(**(preset | given))

    def settled(self, part: Part, distances: bool) -> Self:
        """These settings with resolution and smoothing that are not left open, and the faces that go with them.

        Args:
            part: Which is meshed.
            distances: Its surface is an isosurface of signed distances: it is not smoothed unless that is asked for,
                and found on a finer grid, of which no volume is kept, and reduced to `FINE_FACES`.
        """
        resolution, faces = self.resolution, self.max_faces
        if faces is None and self.texture is not None:
            faces = MAX_FACES
        if resolution is None:
            fine = distances and part != "eyes" and not self.volumes
            resolution = FINE_RESOLUTION if fine else RESOLUTION
            faces = FINE_FACES if fine and faces is None else faces
        smoothing = (0 if distances else SMOOTHED) if self.smoothing is None else self.smoothing
        return replace(self, resolution=resolution, max_faces=faces, smoothing=smoothing)

    def check(self) -> None:
        """Raise UserError for settings that cannot be."""
        if unknown := sorted(set(self.parts) - set(PARTS)):
            raise UserError(f"unknown part {unknown[0]!r}; there are {', '.join(PARTS)}")
        if unknown := sorted(set(self.formats) - set(FORMATS)):
            raise UserError(f"unknown format {unknown[0]!r}; there are {', '.join(FORMATS)}")
        if self.surface not in SURFACES:
            raise UserError(f"unknown surface {self.surface!r}; there are {', '.join(SURFACES)}")
        if unknown := sorted(set(self.volumes) - set(VOLUMES)):
            raise UserError(f"unknown volume format {unknown[0]!r}; there are {', '.join(VOLUMES)}")
        if not self.parts or not self.formats:
            raise UserError("give at least one part and one format")
        if self.points is not None:
            check_points(self.points)
        if self.texture is not None:
            check_texture(self.texture)
