"""A head at one gaze: codes and gaze folded into the streams, and the densities that follow."""

from __future__ import annotations

from functools import cached_property, partial
from typing import TYPE_CHECKING

import numpy as np
import torch

from gazenerf.errors import UserError
from gazenerf.field.compositing import EPSILON, StreamSamples
from gazenerf.geometry import Camera, Gaze
from gazenerf.heads.interface import PARTS, GeometryView, Part, RenderedView
from gazenerf.heads.march import first_surface
from gazenerf.heads.normals import density_normals
from gazenerf.heads.occupancy import OccupiedSteps
from gazenerf.heads.render import published_pass, render_geometry, render_parts

if TYPE_CHECKING:
    from gazenerf.heads.head import Head

NORMAL_RADIUS = 0.012
"""World units over which densities are differenced for normals."""


class BoundHead:
    """See `gazenerf.heads.interface.BoundField`; made by `Head.at`.

    Two paths give the same head: `render` and `render_geometry` are fast, `render_slow` follows the
    paper line by line. With the published `slabs` sampler they agree to rounding.

    Args:
        head: The person.
        gaze: In the head frame.
    """

    def __init__(self, head: Head, gaze: Gaze) -> None:
        self.head, self.gaze = head, gaze
        self.field, self.subject, self.box = head.field, head.subject, head.box
        self.metres_per_unit, self.weights_hash = head.metres_per_unit, head.weights_hash
        config = head.field.config
        self.surface_spread = config.surface_spread if config.geometry == "distance" else None
        self.image_size: int | None = config.image_size
        self.label, self.conditions = head.conditions(gaze)

    def __repr__(self) -> str:
        pitch, yaw = self.gaze.degrees
        return f"BoundHead({self.subject.name!r}, pitch {pitch:.1f}, yaw {yaw:.1f} degrees)"

    @property
    def device(self) -> torch.device:
        """Where densities and pictures are computed."""
        return self.head.device

    @property
    def parts(self) -> tuple[Part, ...]:
        """See `BoundField`."""
        return self.head.parts

    @property
    def background(self) -> np.ndarray:
        """(3,) sRGB mean colour of the picture of the background alone."""
        return self.head.background

    def streams_of(self, part: Part) -> tuple[str, ...]:
        """Names of the streams that make up a part.

        Raises:
            UserError: the field has no such part.
        """
        if part not in PARTS:
            raise UserError(f"unknown part {part!r}; there are {', '.join(PARTS)}")
        if part == "head":
            return tuple(self.field.streams)
        if part not in self.field.streams:
            raise UserError(f"this field has one stream for face and eyes: it has no {part} alone; ask for head")
        return (part,)

    # Densities

    def density(self, points: torch.Tensor, part: Part = "head") -> torch.Tensor:
        """Density (N,) per world unit at points (N, 3); gradients flow to points that ask for them.

        The points may lie on any device; the densities come back to it.
        """
        names = self.streams_of(part)
        here = points.to(self.device)
        with self.head.products():
            if points.requires_grad:
                return self._density(here, names).to(points.device)
            with torch.no_grad():
                return self.head.within_memory(lambda: self.density_of(names, here)).to(points.device)

    def density_of(self, streams: tuple[str, ...], points: torch.Tensor) -> torch.Tensor:
        """Summed density (N,) of streams at points (N, 3), a chunk at a time."""
        return torch.cat([self._density(chunk, streams) for chunk in points.split(self.head.chunk)])

    def _density(self, points: torch.Tensor, streams: tuple[str, ...]) -> torch.Tensor:
        total = points.new_zeros(len(points))
        for name in streams:
            if name == "eyes" and not points.requires_grad and self.eyes_bounds is not None:
                near = self.near_eyes(points)
                if bool(near.any()):
                    total[near] += self.query(name, points[near])
            else:
                total = total + self.query(name, points)
        return total

    def query(self, stream: str, points: torch.Tensor) -> torch.Tensor:
        """Density (N,) of one stream at points (N, 3)."""
        return self.field.query(stream, points[None], self.conditions[stream], features=False)[0][0]

    @cached_property
    def eyes_bounds(self) -> torch.Tensor | None:
        """See `Head.eyes_bounds`."""
        return self.head.eyes_bounds()

    def near_eyes(self, points: torch.Tensor) -> torch.Tensor:
        """(...) bool: may the eyes have density at points (..., 3)?"""
        bounds = self.eyes_bounds
        if bounds is None:
            return torch.ones(points.shape[:-1], dtype=torch.bool, device=points.device)
        return ((points >= bounds[0]) & (points <= bounds[1])).all(-1)

    def surface(
        self,
        rays_o: torch.Tensor,
        rays_d: torch.Tensor,
        streams: tuple[str, ...],
        window: tuple[torch.Tensor, torch.Tensor] | None = None,
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Distance (R,) and hit (R,) bool of the first surface of streams along rays; see `march.first_surface`."""
        steps = OccupiedSteps(self.head.occupancy(streams), rays_o, rays_d, window=window)
        return first_surface(partial(self.density_of, streams), steps, rays_o, rays_d)

    def normals(self, points: torch.Tensor, part: Part = "head", radius: float = NORMAL_RADIUS) -> torch.Tensor:
        """(N, 3) unit outward normals at points (N, 3): minus the density gradient, smoothed over `radius`.

        Of a field that knows distances, the gradient of the distance: its density is so steep that differences of it
        would point to the axes' diagonals.
        """
        falling = partial(self.density, part=part)
        if self.field.config.geometry == "distance":
            falling = partial(self._inwardness, self.streams_of(part))
        with self.head.quickly():
            found = density_normals(falling, points.to(self.device), radius)
        return found.to(points.device)

    def _inwardness(self, streams: tuple[str, ...], points: torch.Tensor) -> torch.Tensor:
        """Minus the distance (N,) of points (N, 3) from the nearest surface of some streams."""

        def inside(chunk: torch.Tensor) -> torch.Tensor:
            found = [self.field.signed_distance(name, chunk[None], self.conditions[name])[0] for name in streams]
            return -torch.stack(found).amin(0)

        return torch.cat([inside(chunk) for chunk in points.split(self.head.chunk)])

    # Features

    def samples(self, stream: str, points: torch.Tensor) -> StreamSamples:
        """A stream's samples at points (R, S, 3)."""
        return self.field.samples(stream, points, self.conditions[stream], batched=False)

    def turn(self, features: torch.Tensor) -> torch.Tensor:
        """Features (..., C) turned by the gaze (paper Sec. 3.2)."""
        return self.field.move_eyes(features, self.label)

    def features(self, points: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Density (N,) and features (N, C) of both streams as one medium at points (N, 3), without gradients."""
        with self.head.quickly():
            found: list[tuple[torch.Tensor, torch.Tensor]] = []
            for name in ("face", "eyes"):
                here = self.near_eyes(points) if name == "eyes" else points.new_ones(len(points), dtype=torch.bool)
                density = points.new_zeros(len(points))
                features = points.new_zeros(len(points), self.field.config.feature_channels)
                queried, hidden = self.field.query(name, points[here][None], self.conditions[name])
                projected = self.field.stream(name).project(hidden, torch.ones_like(queried))[0].float()
                density[here] = queried[0]
                features[here] = self.turn(projected) if name == "eyes" else projected
                found.append((density, features))
        (face, face_features), (eyes, eyes_features) = found
        share = (eyes / (face + eyes).clamp(min=EPSILON))[:, None]
        return face + eyes, torch.lerp(face_features, eyes_features, share)

    # Pictures

    def render(self, camera: Camera, parts: tuple[Part, ...] = ("head",)) -> RenderedView:
        """Pictures at the camera's size, composited from feature maps `upsampling` times smaller.

        A size that is not a multiple is rendered at the next one and resampled. Around the eyes the
        `eyes` picture is the plain background where training never showed that stream (`eyes_box`).
        """
        return self.head.within_memory(lambda: render_parts(self, camera, parts))

    def render_cut_out(self, camera: Camera, parts: tuple[Part, ...] = ("head",)) -> RenderedView:
        """See `gazenerf.heads.cutouts.CutOutField`; the pictures are those of `render`."""
        return self.head.within_memory(lambda: render_parts(self, camera, parts, cutouts=True))

    def render_geometry(self, camera: Camera, part: Part = "head", normals: bool = False) -> GeometryView:
        """Opacity and expected depth along the rays of every pixel; for `head`, of both media as one.

        With `normals`, minus the direction in which density grows at the surface.
        """
        return self.head.within_memory(lambda: render_geometry(self, camera, part, normals))

    def render_slow(self, camera: Camera) -> dict[str, torch.Tensor]:
        """The published forward pass at the field's own size; see `TwoStreamField.published_forward`.

        Raises:
            UserError: the camera is beside or behind the head, where the published samples are undefined.
        """
        return published_pass(self, camera)
