"""A field with a subject and a gaze fixed: codes folded once, then density, geometry and pictures.

Two paths give the same head: `render` and `render_geometry` are fast, `render_slow` follows the
paper line by line. With the published `slabs` sampler they agree to rounding.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cached_property

import cv2
import numpy as np
import torch

from gazenerf.errors import UserError
from gazenerf.field.compositing import composite, composite_joint
from gazenerf.field.interface import OPACITY_FLOOR, PARTS, GeometryView, Part, RenderedView
from gazenerf.field.model import TwoStreamField
from gazenerf.field.occupancy import Occupancy, first_surface
from gazenerf.field.sampling import ray_samples, shell_samples, slab_samples
from gazenerf.geometry import Camera, Gaze, camera_rays
from gazenerf.subjects import Subject

GUIDED_BOX = ((-1.5, -1.7, -1.5), (1.5, 1.5, 1.5))
"""Corners, world units, of the volume that natively trained fields fill."""

SLAB_HALF_WIDTH = 1.93
"""Half width of the volume that the published neutral camera sees."""

SLAB_SLOPE = 0.5
"""Slabs are used while |d_z| of every ray exceeds this: cameras up to about 50 degrees from the front."""

CHUNK = 2**16

MAX_KNOWN = 4
"""Subjects whose occupancy a field remembers."""


class BoundTwoStream:
    """See `gazenerf.field.interface.BoundField`.

    Args:
        field: The field.
        subject: Its codes must have the field's sizes.
        gaze: In the head frame; a warning is given beyond the trained range.
        sampler: `slabs` or `guided`; the field's own when None.
        bfloat16: Query in bfloat16, several times faster where the processor has matrix tiles.

    Raises:
        UserError: code sizes differ, or the gaze is not finite.
    """

    def __init__(
        self,
        field: TwoStreamField,
        subject: Subject,
        gaze: Gaze,
        *,
        sampler: str | None = None,
        bfloat16: bool = False,
    ) -> None:
        config = field.config
        if subject.codes.sizes != config.code_sizes:
            raise UserError(
                f"{subject.name} has codes of {subject.codes.sizes} (identity, expression, texture, illumination), "
                f"the field takes {config.code_sizes}; choose a subject made for this field"
            )
        if not (math.isfinite(gaze.pitch) and math.isfinite(gaze.yaw)):
            raise UserError("the gaze holds NaN or infinite angles")
        if config.trained_gaze_range is not None:
            limits = config.trained_gaze_range
            if any(abs(angle) > limit + 0.5 for angle, limit in zip(gaze.degrees, limits, strict=True)):
                warnings.warn(
                    f"gaze {gaze.degrees[0]:.0f} {gaze.degrees[1]:.0f} is beyond the trained range "
                    f"(pitch +-{limits[0]:.0f}, yaw +-{limits[1]:.0f} degrees)",
                    stacklevel=3,
                )
        self.field, self.subject, self.gaze = field, subject, gaze
        self.metres_per_unit = config.metres_per_unit
        self.weights_hash = field.weights_hash
        self.sampler = sampler or config.sampler
        self.bfloat16 = bfloat16
        if self.sampler == "guided":
            self.box = np.array(GUIDED_BOX)
        else:
            side = SLAB_HALF_WIDTH
            self.box = np.array([[-side, -side, config.z_far], [side, side, config.z_near]])
        with self._exact():
            self._shape = torch.from_numpy(subject.codes.shape_code)[None]
            self._appearance = torch.from_numpy(subject.codes.appearance_code)[None]
            self._label = field.label(torch.from_numpy(gaze.label)[None])
            self._conditions = {
                name: field.stream(name).condition(self._shape, self._appearance, self._label) for name in field.streams
            }

    @contextmanager
    def _exact(self) -> Iterator[None]:
        with torch.no_grad(), torch.autocast("cpu", dtype=torch.bfloat16, enabled=False):
            yield

    @contextmanager
    def _fast(self) -> Iterator[None]:
        with torch.inference_mode(), torch.autocast("cpu", dtype=torch.bfloat16, enabled=self.bfloat16):
            yield

    @cached_property
    def background(self) -> np.ndarray:
        """(3,) sRGB mean colour of the picture of the background alone."""
        with self._fast():
            size = self.field.config.feature_size
            return self.field.renderer(self.field.renderer.background(size, size)).mean((0, 2, 3)).numpy()

    def _streams_of(self, part: Part) -> tuple[str, ...]:
        if part not in PARTS:
            raise UserError(f"unknown part {part!r}; there are {', '.join(PARTS)}")
        if part == "head":
            return tuple(self.field.streams)
        if part not in self.field.streams:
            raise UserError(f"this field has one stream; its only part is head, not {part}")
        return (part,)

    def density(self, points: torch.Tensor, part: Part = "head") -> torch.Tensor:
        """Density (N,) per world unit at points (N, 3); gradients flow to points that ask for them."""
        names = self._streams_of(part)
        with torch.autocast("cpu", dtype=torch.bfloat16, enabled=self.bfloat16):
            if points.requires_grad:
                return self._density(points, names)
            with torch.no_grad():
                return torch.cat([self._density(chunk, names) for chunk in points.split(CHUNK)])

    def _density(self, points: torch.Tensor, names: tuple[str, ...]) -> torch.Tensor:
        total = points.new_zeros(len(points))
        for name in names:
            if name == "eyes" and not points.requires_grad and (bounds := self._eyes_bounds) is not None:
                near = ((points >= bounds[0]) & (points <= bounds[1])).all(-1)
                if bool(near.any()):
                    total[near] += self._query(name, points[near])
            else:
                total = total + self._query(name, points)
        return total

    def _query(self, name: str, points: torch.Tensor) -> torch.Tensor:
        density = self.field.stream(name).query(points[None], self._conditions[name], features=False)[0][0]
        return self.field.confine(name, density, points)

    @cached_property
    def _grids(self) -> dict[str, Occupancy]:
        """Occupancy of each stream, found once a subject and grown so that it holds for every gaze."""
        known = self.field.occupancies
        key = (self.subject.codes.shape_code.tobytes(), self.sampler)
        if key not in known:
            box = torch.from_numpy(self.box.astype(np.float32))
            if len(known) >= MAX_KNOWN:
                known.pop(next(iter(known)))
            with self._fast():
                known[key] = {
                    name: Occupancy.of(lambda points, name=name: self._query(name, points), box)
                    for name in self.field.streams
                }
        return known[key]

    @cached_property
    def _eyes_bounds(self) -> torch.Tensor | None:
        """Box around the eyes' density, None when it is not known to be small."""
        if self.sampler != "guided" or "eyes" not in self.field.streams:
            return None
        bounds = self._grids["eyes"].bounds()
        return torch.zeros(2, 3) if bounds is None else bounds

    def _occupancy(self, names: tuple[str, ...]) -> Occupancy:
        grids = [self._grids[name] for name in names]
        cells = grids[0].cells
        for grid in grids[1:]:
            cells = cells | grid.cells
        return Occupancy(cells, grids[0].box)

    def _surface(
        self, rays_o: torch.Tensor, rays_d: torch.Tensor, names: tuple[str, ...], refinements: int
    ) -> tuple[torch.Tensor, torch.Tensor]:
        occupancy = self._occupancy(names)
        return first_surface(
            lambda points: torch.cat([self._density(chunk, names) for chunk in points.split(CHUNK)]),
            occupancy, rays_o, rays_d, refinements=refinements,
        )  # fmt: skip

    def _even_samples(self, rays_o: torch.Tensor, rays_d: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """The published slabs where every ray descends steeply in z, else as many steps through the box.

        Slabs are undefined for rays at right angles to z and in the wrong order from behind.
        """
        if bool((rays_d[:, 2] < -SLAB_SLOPE).all()):
            return slab_samples(rays_o, rays_d, self.field.config)
        box = torch.from_numpy(self.box.astype(np.float32))
        return ray_samples(rays_o, rays_d, box, self.field.config.samples)

    def _samples(
        self, rays_o: torch.Tensor, rays_d: torch.Tensor, names: tuple[str, ...]
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Rays that can hit something (indices), and their t and deltas."""
        config = self.field.config
        if self.sampler == "slabs":
            return torch.arange(len(rays_o)), *self._even_samples(rays_o, rays_d)
        distance, hit = self._surface(rays_o, rays_d, names, refinements=1)
        rays = hit.nonzero()[:, 0]
        return rays, *shell_samples(distance[rays], config.shell, config.shell_samples)

    def _composited(
        self, rays_o: torch.Tensor, rays_d: torch.Tensor, names: tuple[str, ...], background: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Features (R, C) with background, opacity (R,) and expected distance (R,) of one medium."""
        features, opacity = background.clone(), torch.zeros(len(rays_o))
        distance = torch.full((len(rays_o),), torch.nan)
        rays, t, deltas = self._samples(rays_o, rays_d, names)
        for part in torch.arange(len(rays)).split(max(1, CHUNK // max(1, t.shape[1] if len(rays) else 1))):
            index = rays[part]
            points = rays_o[index, None] + t[part, :, None] * rays_d[index, None]
            rows, alpha, expected = self._composite_chunk(points, t[part], deltas[part], names)
            if names == ("eyes",):
                rows = self.field.move_eyes(rows, self._label)
                empty = self.field.move_eyes(background[index], self._label)
            else:
                empty = background[index]
            features[index] = rows + (1.0 - alpha[:, None]) * empty
            opacity[index] = alpha
            distance[index] = torch.where(alpha >= OPACITY_FLOOR, expected, torch.nan)
        if names == ("eyes",) and len(rays) < len(rays_o):
            missed = torch.ones(len(rays_o), dtype=torch.bool)
            missed[rays] = False
            features[missed] = self.field.move_eyes(background[missed], self._label)
        return features, opacity, distance

    def _smooth_outline(
        self,
        camera: Camera,
        grid: np.ndarray,
        names: tuple[str, ...],
        background: torch.Tensor,
        found: tuple[torch.Tensor, torch.Tensor, torch.Tensor],
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Features and opacity along the outline averaged over four rays a feature pixel.

        One ray decides for `upsampling` squared picture pixels whether they show the head, which
        draws outlines as stairs. Published fields are left as they are.
        """
        features, opacity, distance = found
        if self.sampler != "guided":
            return found
        solid = (opacity >= 0.5).reshape(grid.shape[:2]).numpy().astype(np.uint8)
        cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
        outline = np.flatnonzero(cv2.dilate(solid, cross) != cv2.erode(solid, cross))
        if not len(outline):
            return found
        inside = np.array([[-0.25, -0.25], [0.25, -0.25], [-0.25, 0.25], [0.25, 0.25]])
        rays_o, rays_d = camera_rays(camera, grid.reshape(-1, 2)[outline, None] + inside)
        index = torch.from_numpy(outline)
        fine, alpha, _ = self._composited(rays_o, rays_d, names, background[index].repeat_interleave(4, dim=0))
        features[index] = fine.reshape(len(outline), 4, -1).mean(1)
        opacity[index] = alpha.reshape(-1, 4).mean(1)
        return features, opacity, distance

    def _composite_chunk(
        self, points: torch.Tensor, t: torch.Tensor, deltas: torch.Tensor, names: tuple[str, ...]
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        found: dict[str, tuple[torch.Tensor, torch.Tensor]] = {}
        near = torch.ones(len(points), dtype=torch.bool)
        for name in names:
            stream = self.field.stream(name)
            if name == "eyes" and len(names) > 1 and (bounds := self._eyes_bounds) is not None:
                near = ((points >= bounds[0]) & (points <= bounds[1])).all(-1).any(-1)
            density, hidden = stream.query(points[near][None], self._conditions[name])
            found[name] = self.field.confine(name, density[0], points[near]), hidden[0].float()
        leading = next(iter(names))
        total = found[leading][0].clone()
        if len(names) > 1:
            total[near] = total[near] + found["eyes"][0]
        weights, opacity = composite(total, deltas)
        first, hidden = found[leading]
        own, w_eyes = weights, weights[:0]
        if len(names) > 1:
            own = weights.clone()
            own[near], w_eyes, _ = composite_joint(first[near], found["eyes"][0], deltas[near])
        rows = self.field.stream(leading).project((own[..., None] * hidden).sum(1)[None], own.sum(-1)[None])[0].float()
        if len(names) > 1:
            eyes = self.field.stream("eyes").project(
                (w_eyes[..., None] * found["eyes"][1]).sum(1)[None], w_eyes.sum(-1)[None]
            )[0]
            rows[near] += self.field.move_eyes(eyes.float(), self._label)
        expected = (weights * t).sum(-1) / opacity.clamp(min=1e-6)
        return rows, opacity, expected

    def render(self, camera: Camera, parts: tuple[Part, ...] = ("head",)) -> RenderedView:
        """Pictures at the camera's size, composited from feature maps `upsampling` times smaller.

        A size that is not a multiple is rendered at the next one and resampled. Around the eyes the
        `eyes` picture is the plain background where training never showed that stream (`eyes_box`).
        """
        for part in parts:
            self._streams_of(part)
        config = self.field.config
        k = config.upsampling
        columns, rows = max(2, -(-camera.width // k)), max(2, -(-camera.height // k))
        small = camera.resized(columns, rows)
        grid = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1) + config.ray_offset
        rays_o, rays_d = camera_rays(small, grid)
        images: dict[Part, np.ndarray] = {}
        geometry: dict[Part, GeometryView] = {}
        with self._fast():
            background = self.field.renderer.background(rows, columns)[0].flatten(1).T.float()
            cache: dict[tuple[str, ...], tuple[torch.Tensor, torch.Tensor, torch.Tensor]] = {}

            def composited(names: tuple[str, ...]) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
                if names not in cache:
                    found = self._composited(rays_o, rays_d, names, background)
                    cache[names] = self._smooth_outline(small, grid, names, background, found)
                return cache[names]

            for part in parts:
                names = self._streams_of(part)
                if len(names) > 1 and config.merge == "max":
                    face, eyes = composited(("face",)), composited(("eyes",))
                    features = torch.maximum(face[0], eyes[0])
                    opacity = 1.0 - (1.0 - face[1]) * (1.0 - eyes[1])
                    distance = torch.fmin(face[2], eyes[2])
                else:
                    features, opacity, distance = composited(names)
                    if names == ("head",):
                        features = self.field.move_eyes(features, self._label)
                picture = self.field.renderer(features.T.reshape(1, -1, rows, columns))[0]
                image = np.ascontiguousarray(picture.permute(1, 2, 0).float().numpy())
                if names == ("eyes",) and config.eyes_box is not None:
                    image = self._on_background(image, opacity.reshape(rows, columns).numpy())
                if image.shape[:2] != (camera.height, camera.width):
                    image = cv2.resize(image, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
                images[part] = np.clip(image, 0.0, 1.0)
                geometry[part] = GeometryView(
                    small, opacity.reshape(rows, columns).numpy(), distance.reshape(rows, columns).numpy()
                )
        return RenderedView(camera, images, geometry)

    def _on_background(self, image: np.ndarray, opacity: np.ndarray) -> np.ndarray:
        """A picture (H, W, 3) where a feature map's opacity (h, w) or a neighbour's is, else the background."""
        grown = cv2.dilate(opacity.astype(np.float32), np.ones((3, 3), np.uint8))
        share = cv2.resize(grown, (image.shape[1], image.shape[0]), interpolation=cv2.INTER_LINEAR)[..., None]
        return share * image + (1.0 - share) * self.background

    def render_geometry(self, camera: Camera, part: Part = "head", normals: bool = False) -> GeometryView:
        """Opacity and expected depth along the rays of every pixel; for `head`, of both media as one.

        With `normals`, minus the direction in which density grows at the surface.
        """
        names = self._streams_of(part)
        rays_o, rays_d = camera_rays(camera)
        opacity, depth = torch.zeros(len(rays_o)), torch.full((len(rays_o),), torch.nan)
        with self._fast():
            if self.sampler == "guided":
                distance, hit = self._surface(rays_o, rays_d, names, refinements=1)
                rays = hit.nonzero()[:, 0]
                for index in rays.split(CHUNK // 16):
                    t, deltas = shell_samples(distance[index], 0.06, 16)
                    points = rays_o[index, None] + t[..., None] * rays_d[index, None]
                    density = self._density(points.reshape(-1, 3), names).reshape(t.shape)
                    weights, alpha = composite(density, deltas)
                    opacity[index] = alpha
                    depth[index] = (weights * t).sum(-1) / alpha.clamp(min=1e-6)
            else:
                every_t, every_delta = self._even_samples(rays_o, rays_d)
                for index in torch.arange(len(rays_o)).split(CHUNK // 64):
                    t, deltas = every_t[index], every_delta[index]
                    points = rays_o[index, None] + t[..., None] * rays_d[index, None]
                    density = self._density(points.reshape(-1, 3), names).reshape(t.shape)
                    weights, alpha = composite(density, deltas)
                    opacity[index] = alpha
                    depth[index] = (weights * t).sum(-1) / alpha.clamp(min=1e-6)
        depth[opacity < OPACITY_FLOOR] = torch.nan
        shape = (camera.height, camera.width)
        vectors = None
        if normals:
            vectors = np.full((*shape, 3), np.nan, dtype=np.float32)
            seen = depth.isfinite()
            at = (rays_o + depth[:, None] * rays_d)[seen]
            vectors[seen.reshape(shape).numpy()] = self.normals(at, part).numpy()
        return GeometryView(camera, opacity.reshape(shape).numpy(), depth.reshape(shape).numpy(), vectors)

    def normals(self, points: torch.Tensor, part: Part = "head", radius: float = 0.012) -> torch.Tensor:
        """(N, 3) unit outward normals at points (N, 3): minus the density gradient, smoothed.

        The gradient is taken by central differences over `radius` (world units), which averages
        over the same scale whatever the sharpness of the field.
        """
        offsets = radius * torch.cat([torch.eye(3), -torch.eye(3)])
        with self._fast():
            values = [self.density(points + offset, part) for offset in offsets]
        gradient = torch.stack([values[i] - values[i + 3] for i in range(3)], dim=-1)
        return -gradient / gradient.norm(dim=-1, keepdim=True).clamp(min=1e-12)

    def render_slow(self, camera: Camera) -> dict[str, torch.Tensor]:
        """The published forward pass at the field's own size; see `TwoStreamField.render_reference`.

        Raises:
            UserError: the camera is beside or behind the head, where the published samples are undefined.
        """
        if not bool((camera_rays(camera.resized(8))[1][:, 2] < -SLAB_SLOPE).all()):
            raise UserError("the published path needs a camera in front of the head; use render for other views")
        size = self.field.config.feature_size
        small = camera.resized(size)
        with self._exact():
            return self.field.render_reference(
                self._shape,
                self._appearance,
                self._label,
                torch.from_numpy(small.world_from_camera[None, :3, :3].astype(np.float32)),
                torch.from_numpy(small.world_from_camera[None, :3, 3:].astype(np.float32)),
                torch.from_numpy(np.linalg.inv(small.intrinsics)[None].astype(np.float32)),
            )
