"""What every field offers, whoever trained it: density, features and pictures of one bound head.

Orbits, meshes and checks speak to a `BoundField` only, so an analytic test scene and a trained
two-stream field are interchangeable.
"""

from __future__ import annotations

import io
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, Protocol, runtime_checkable

import numpy as np
import torch
from PIL import Image

from gazenerf.geometry import Camera, Gaze
from gazenerf.geometry.paths import GazeRange
from gazenerf.subjects import Subject

Part = Literal["face", "eyes", "head"]
"""`face` and `eyes` are the two trained volumes. `head` is this project's combination of them: in
space the sum of both densities (two media in one place), in pictures the field's own merge. The
published method has no joint density."""

PARTS: tuple[Part, ...] = ("face", "eyes", "head")

OPACITY_FLOOR = 0.5
"""Below this opacity a ray has no surface and its expected depth is NaN."""


@dataclass(frozen=True)
class GeometryView:
    """Opacity and expected depth of one part along the rays of one camera.

    Attributes:
        camera: Its size is the size of the arrays.
        opacity: (H, W) float32 in [0, 1].
        depth: (H, W) float32 Euclidean distance from the camera centre in world units, divided by
            opacity; NaN where opacity is below `OPACITY_FLOOR`.
        normals: (H, W, 3) float32 unit outward normals in the world frame, NaN where there is no
            surface; None when not computed.
    """

    camera: Camera
    opacity: np.ndarray
    depth: np.ndarray
    normals: np.ndarray | None = None

    def points(self) -> np.ndarray:
        """(H, W, 3) float64 world points of the surface, NaN where there is none."""
        return self.camera.unproject(self.depth)

    def __repr__(self) -> str:
        seen = np.isfinite(self.depth)
        reach = f", depth {self.depth[seen].min():.2f} to {self.depth[seen].max():.2f} units" if seen.any() else ""
        return f"GeometryView({self.camera.width}x{self.camera.height}, {seen.mean():.0%} of pixels seen{reach})"

    @property
    def depth_z(self) -> np.ndarray:
        """(H, W) camera z of the surface, world units."""
        return (self.depth * self.camera.ray_z()).astype(np.float32)


@dataclass(frozen=True)
class RenderedView:
    """Pictures of a bound head from one camera, per part.

    Attributes:
        camera: The camera of the pictures.
        images: Part to (H, W, 3) float32 sRGB in [0, 1] at the camera's size.
        geometry: Part to the opacity and depth that the pictures were composited from, at the
            size of the feature map.
        cutouts: Part to (H, W, 4) float32 in [0, 1], the picture without what is behind it: sRGB times opacity, and
            opacity. Only where it was asked for; see `gazenerf.heads.cutouts`.
    """

    camera: Camera
    images: dict[Part, np.ndarray]
    geometry: dict[Part, GeometryView] = field(default_factory=dict)
    cutouts: dict[Part, np.ndarray] = field(default_factory=dict)

    @property
    def image(self) -> np.ndarray:
        """(H, W, 3) the merged picture."""
        return self.images["head"]

    def pixels(self, part: Part = "head") -> np.ndarray:
        """(H, W, 3) uint8 picture of a part, as files hold it."""
        return (255.0 * np.clip(self.images[part], 0.0, 1.0)).round().astype(np.uint8)

    def with_head(
        self, image: np.ndarray, geometry: GeometryView, parts: tuple[Part, ...], cutout: np.ndarray | None = None
    ) -> RenderedView:
        """This view and the picture (H, W, 3) of the head with its geometry, in the order of `parts`."""
        images, seen = {**self.images, "head": image}, {**self.geometry, "head": geometry}
        cutouts = self.cutouts if cutout is None else {**self.cutouts, "head": cutout}
        return RenderedView(
            self.camera,
            {part: images[part] for part in parts},
            {part: seen[part] for part in parts},
            {part: cutouts[part] for part in parts if part in cutouts},
        )

    def save(self, path: str | Path, part: Part = "head") -> None:
        """Write the picture of a part as PNG, JPEG or WebP, by the file's name.

        Before another background, or without one: `gazenerf.heads.backgrounds.Background.picture` of a cutout.
        """
        Image.fromarray(self.pixels(part)).save(path)

    def __repr__(self) -> str:
        return f"RenderedView({self.camera.width}x{self.camera.height}, {' '.join(self.images)})"

    def _repr_png_(self) -> bytes:
        """The pictures side by side, for notebooks."""
        buffer = io.BytesIO()
        Image.fromarray(np.concatenate([self.pixels(part) for part in self.images], axis=1)).save(buffer, "png")
        return buffer.getvalue()


@runtime_checkable
class BoundField(Protocol):
    """A field with a subject and a gaze fixed.

    Attributes:
        subject: Whose head it is.
        gaze: Where the eyes look, head frame.
        box: (2, 3) float64 lower and upper corner of the volume where density may be non-zero.
        metres_per_unit: Size of a world unit.
        weights_hash: Names the weights in sidecars and reports.
        surface_spread: Where densities follow from signed distances, the scale of their Laplace distribution, world
            units, so that the surface is where density is half of one over it; None where densities are learned.
        image_size: Side of the pictures that it learned from, pixels: in smaller ones it draws the eyes less exactly.
            None where it learned from none.
    """

    subject: Subject
    gaze: Gaze
    box: np.ndarray
    metres_per_unit: float
    weights_hash: str
    surface_spread: float | None
    image_size: int | None

    @property
    def device(self) -> torch.device:
        """Where densities and pictures are computed."""
        ...

    @property
    def parts(self) -> tuple[Part, ...]:
        """The parts that there are: `head`, and `face` and `eyes` where the field has two streams."""
        ...

    @property
    def background(self) -> np.ndarray:
        """(3,) sRGB of an empty ray."""
        ...

    def density(self, points: torch.Tensor, part: Part = "head") -> torch.Tensor:
        """Density (N,) >= 0 per world unit at points (N, 3), differentiable in the points.

        The points may lie on any device; the densities come back to it.
        """
        ...

    def render(self, camera: Camera, parts: tuple[Part, ...] = ("head",)) -> RenderedView:
        """Pictures of the asked parts, with their feature-map opacity and depth."""
        ...

    def render_geometry(self, camera: Camera, part: Part = "head", normals: bool = False) -> GeometryView:
        """Opacity, expected depth and, on request, density-gradient normals at the camera's size."""
        ...


@runtime_checkable
class HeadField(Protocol):
    """What a field says of one person, at every gaze; safe to use from several threads.

    `gazenerf.heads.Head` is the one for trained fields. Orbits, meshes, checks and viewers take any of these.
    """

    @property
    def subject(self) -> Subject:
        """Whose head it is."""
        ...

    @property
    def device(self) -> torch.device:
        """Where densities and pictures are computed."""
        ...

    @property
    def trained_range(self) -> GazeRange | None:
        """The gazes that the field was trained on, None where that is not known."""
        ...

    def at(self, gaze: Gaze) -> BoundField:
        """The head at a gaze (head frame)."""
        ...
