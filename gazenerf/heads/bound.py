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
from typing import TYPE_CHECKING

import numpy as np
import torch
import torch.nn.functional as F

from gazenerf.errors import UserError
from gazenerf.field.compositing import EPSILON, composite, composite_joint
from gazenerf.field.model import TwoStreamField
from gazenerf.field.sampling import ray_samples, shell_samples, slab_samples
from gazenerf.geometry import Camera, Gaze, camera_rays
from gazenerf.heads.feature_map import Composited, FeatureGrid, Window, to_picture
from gazenerf.heads.interface import OPACITY_FLOOR, PARTS, GeometryView, Part, RenderedView
from gazenerf.heads.occupancy import Occupancy, first_surface
from gazenerf.heads.upsampler import Upsampler
from gazenerf.subjects import Subject

if TYPE_CHECKING:
    from gazenerf.heads.baked import BakedHead

GUIDED_BOX = ((-1.5, -1.7, -1.5), (1.5, 1.5, 1.5))
"""Corners, world units, of the volume that natively trained fields fill."""

SLAB_HALF_WIDTH = 1.93
"""Half width of the volume that the published neutral camera sees."""

SLAB_SLOPE = 0.5
"""Slabs are used while |d_z| of every ray exceeds this: cameras up to about 50 degrees from the front."""

CHUNK = 2**13
"""Points asked for at once. Larger arrays come fresh from the system every time, which costs a third of the time."""

EVERYWHERE = 0.9
"""Share of the box above which a density has no surface to look for."""

SHALLOW = 0.9
"""Opacity that a shell around a surface has on most rays; haze has less, and needs even samples."""

SHELL_FRONT, SHELL_LEFT = 6, 5e-3
"""Samples of a shell asked for at first, and the share of light below which the others are not."""

EVEN_FRONT, EVEN_LEFT = 16, 1e-6
"""The same for even samples, whose picture must stay the published one to rounding."""

WINDOW = (0.06, 0.09)
"""World units before and behind a surface known at one gaze in which it is looked for at another."""

MAX_KNOWN = 4
"""Subjects whose occupancy a field remembers."""


class BoundTwoStream:
    """See `gazenerf.heads.interface.BoundField`.

    Args:
        field: The field.
        subject: Its codes must have the field's sizes.
        gaze: In the head frame.
        sampler: `slabs` or `guided`; the field's own when None.
        bfloat16: Query in bfloat16, several times faster where the processor has matrix tiles.
        upsampler: One of `gazenerf.heads.upsampler.BACKENDS`; `folded` when None.

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
        upsampler: str | None = None,
    ) -> None:
        config = field.config
        if subject.codes.sizes != config.code_sizes:
            raise UserError(
                f"{subject.name} has codes of {subject.codes.sizes} (identity, expression, texture, illumination), "
                f"the field takes {config.code_sizes}; choose a subject made for this field"
            )
        if not (math.isfinite(gaze.pitch) and math.isfinite(gaze.yaw)):
            raise UserError("the gaze holds NaN or infinite angles")
        self.field, self.subject, self.gaze = field, subject, gaze
        self.metres_per_unit = config.metres_per_unit
        self.weights_hash = field.weights_hash
        self.sampler = sampler or config.sampler
        self.bfloat16 = bfloat16
        self.upsampler = upsampler
        self.upsample: Upsampler = field.upsampler("reference" if bfloat16 else upsampler or "folded")
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

    @property
    def parts(self) -> tuple[Part, ...]:
        """`head`, and `face` and `eyes` where the field has two streams."""
        return ("face", "eyes", "head") if "eyes" in self.field.streams else ("head",)

    @property
    def background(self) -> np.ndarray:
        """(3,) sRGB mean colour of the picture of the background alone."""
        return self._background

    @cached_property
    def _background(self) -> np.ndarray:
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

    def at(self, gaze: Gaze) -> BoundTwoStream:
        """The same subject at another gaze; what is known of the subject is kept."""
        return BoundTwoStream(
            self.field, self.subject, gaze,
            sampler=self.sampler, bfloat16=self.bfloat16, upsampler=self.upsampler,
        )  # fmt: skip

    def bake(self) -> BakedHead:
        """See `gazenerf.heads.baked.bake`."""
        from gazenerf.heads.baked import bake

        return bake(self)

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
        return self.field.query(name, points[None], self._conditions[name], features=False)[0][0]

    @cached_property
    def _grids(self) -> dict[str, Occupancy]:
        """Occupancy of each stream, found once a subject and grown so that it holds for every gaze."""
        known = self.field.occupancies
        key = (self.subject.codes.shape_code.tobytes(), self.sampler, self.field.version)
        if key not in known:
            box = torch.from_numpy(self.box.astype(np.float32))
            if len(known) >= MAX_KNOWN:
                known.pop(next(iter(known)))
            with self._fast():
                known[key] = {
                    name: Occupancy.of(
                        lambda points, name=name: self._query(name, points), box, within=self._trained_box(name)
                    )
                    for name in self.field.streams
                }
        return known[key]

    def _trained_box(self, name: str) -> torch.Tensor | None:
        """(2, 3) box outside which a stream's density is 0, None when there is none."""
        box = self.field.config.eyes_box
        return torch.tensor(box).reshape(2, 3) if name == "eyes" and box is not None else None

    @cached_property
    def _eyes_bounds(self) -> torch.Tensor | None:
        """Box around the eyes' density, None when it is not known to be small."""
        if "eyes" not in self.field.streams:
            return None
        if self.sampler != "guided":
            return self._trained_box("eyes")  # all that is known without looking
        bounds = self._grids["eyes"].bounds()
        return torch.zeros(2, 3) if bounds is None else bounds

    def occupancy(self, names: tuple[str, ...]) -> Occupancy:
        """Where the streams' densities can be, whatever the gaze."""
        return Occupancy.union([self._grids[name] for name in names])

    def _surface(
        self, rays_o: torch.Tensor, rays_d: torch.Tensor, names: tuple[str, ...], window: Window | None = None
    ) -> tuple[torch.Tensor, torch.Tensor]:
        return first_surface(
            lambda points: torch.cat([self._density(chunk, names) for chunk in points.split(CHUNK)]),
            self.occupancy(names), rays_o, rays_d, window=window,
        )  # fmt: skip

    @cached_property
    def sparse(self) -> bool:
        """Are rays sampled around a surface only? Not where the density is nearly everywhere; that is warned of."""
        if self.sampler != "guided":
            return False
        share = self.occupancy(tuple(self.field.streams)).share
        if share > EVERYWHERE:
            self._warn_dense(f"density fills {share:.0%} of the box")
        return share <= EVERYWHERE

    def _warn_dense(self, reason: str) -> None:
        warnings.warn(
            f"{self.subject.name}: {reason}, there is no surface to sample around (untrained weights?); "
            "rays are sampled evenly instead, which is slower",
            stacklevel=2,
        )

    def head_features(self, points: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Density (N,) and features (N, C) of both streams as one medium at points (N, 3), without gradients."""
        with self._fast():
            found: list[tuple[torch.Tensor, torch.Tensor]] = []
            for name in ("face", "eyes"):
                here = torch.ones(len(points), dtype=torch.bool)
                if name == "eyes" and (bounds := self._eyes_bounds) is not None:
                    here = ((points >= bounds[0]) & (points <= bounds[1])).all(-1)
                density = points.new_zeros(len(points))
                features = points.new_zeros(len(points), self.field.config.feature_channels)
                queried, hidden = self.field.query(name, points[here][None], self._conditions[name])
                projected = self.field.stream(name).project(hidden, torch.ones_like(queried))[0].float()
                density[here] = queried[0]
                features[here] = self.field.move_eyes(projected, self._label) if name == "eyes" else projected
                found.append((density, features))
        (face, face_features), (eyes, eyes_features) = found
        share = (eyes / (face + eyes).clamp(min=EPSILON))[:, None]
        return face + eyes, torch.lerp(face_features, eyes_features, share)

    def composite_near(
        self, rays_o: torch.Tensor, rays_d: torch.Tensor, distance: torch.Tensor, background: torch.Tensor
    ) -> Composited:
        """The head along rays whose surface is known to lie near a distance (R,); see `WINDOW`."""
        with self._fast():
            window = distance - WINDOW[0], distance + WINDOW[1]
            return self._composited(rays_o, rays_d, tuple(self.field.streams), background, window)

    def _even_samples(self, rays_o: torch.Tensor, rays_d: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """The published slabs where every ray descends steeply in z, else as many steps through the box.

        Slabs are undefined for rays at right angles to z and in the wrong order from behind.
        """
        if bool((rays_d[:, 2] < -SLAB_SLOPE).all()):
            return slab_samples(rays_o, rays_d, self.field.config)
        box = torch.from_numpy(self.box.astype(np.float32))
        return ray_samples(rays_o, rays_d, box, self.field.config.samples)

    def _samples(
        self, rays_o: torch.Tensor, rays_d: torch.Tensor, names: tuple[str, ...], window: Window | None, sparse: bool
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Rays that can hit something (indices), and their t and deltas."""
        config = self.field.config
        if not sparse:
            return torch.arange(len(rays_o)), *self._even_samples(rays_o, rays_d)
        distance, hit = self._surface(rays_o, rays_d, names, window)
        rays = hit.nonzero()[:, 0]
        return rays, *shell_samples(distance[rays], config.shell, config.shell_samples)

    def _composited(
        self,
        rays_o: torch.Tensor,
        rays_d: torch.Tensor,
        names: tuple[str, ...],
        background: torch.Tensor,
        window: Window | None = None,
        sparse: bool = True,
    ) -> Composited:
        """Features with background, opacity and expected distance of one medium; evenly sampled unless `sparse`."""
        features, opacity = background.clone(), torch.zeros(len(rays_o))
        distance = torch.full((len(rays_o),), torch.nan)
        rays, t, deltas = self._samples(rays_o, rays_d, names, window, sparse)
        segments = (SHELL_FRONT, SHELL_LEFT) if sparse else (EVEN_FRONT, EVEN_LEFT)
        for part in torch.arange(len(rays)).split(max(1, CHUNK // max(1, t.shape[1] if len(rays) else 1))):
            index = rays[part]
            points = rays_o[index, None] + t[part, :, None] * rays_d[index, None]
            rows, alpha, expected = self._front_to_back(points, t[part], deltas[part], names, *segments)
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

    def _feature_map(self, grid: FeatureGrid, names: tuple[str, ...], background: torch.Tensor) -> Composited:
        found = self._composited(grid.rays_o, grid.rays_d, names, background, sparse=self.sparse)
        if not self.sparse:  # outlines of published fields are left as they are
            return found
        seen = found[1][found[1] > 0]
        if len(seen) and float(seen.median()) < SHALLOW:
            self._warn_dense(f"a shell around the surface holds {float(seen.median()):.0%} of what is seen")
            return self._composited(grid.rays_o, grid.rays_d, names, background, sparse=False)
        return grid.smooth_outline(
            lambda o, d, back, window: self._composited(o, d, names, back, window), background, found
        )

    def _front_to_back(
        self,
        points: torch.Tensor,
        t: torch.Tensor,
        deltas: torch.Tensor,
        names: tuple[str, ...],
        front: int,
        left: float,
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """`_composite_chunk` of `front` samples at a time, on with the rays that have more than `left` of their light.

        What lies behind a segment of a ray is added times the light that passes the segment.
        """
        rows, opacity, expected = self._composite_chunk(points[:, :front], t[:, :front], deltas[:, :front], names)
        on = (1.0 - opacity > left).nonzero()[:, 0] if t.shape[1] > front else t.new_zeros(0, dtype=torch.long)
        if len(on):
            behind = self._front_to_back(points[on, front:], t[on, front:], deltas[on, front:], names, front, left)
            passed = 1.0 - opacity[on]
            near, far = opacity[on], passed * behind[1]
            rows[on] += passed[:, None] * behind[0]
            expected[on] = (near * expected[on] + far * behind[2]) / (near + far).clamp(min=1e-6)
            opacity[on] = near + far
        return rows, opacity, expected

    def _composite_chunk(
        self, points: torch.Tensor, t: torch.Tensor, deltas: torch.Tensor, names: tuple[str, ...]
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        found: dict[str, tuple[torch.Tensor, torch.Tensor]] = {}
        near = torch.ones(len(points), dtype=torch.bool)
        for name in names:
            if name == "eyes" and len(names) > 1 and (bounds := self._eyes_bounds) is not None:
                near = ((points >= bounds[0]) & (points <= bounds[1])).all(-1).any(-1)
            density, hidden = self.field.query(name, points[near][None], self._conditions[name])
            found[name] = density[0], hidden[0].float()
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
        grid = FeatureGrid.of(camera, config)
        rows, columns = grid.shape
        images: dict[Part, np.ndarray] = {}
        geometry: dict[Part, GeometryView] = {}
        with self._fast():
            background = self.field.renderer.background(rows, columns)[0].flatten(1).T.float()
            cache: dict[tuple[str, ...], Composited] = {}

            def composited(names: tuple[str, ...]) -> Composited:
                if names not in cache:
                    cache[names] = self._feature_map(grid, names, background)
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
                picture = self.upsample(features.T.reshape(1, -1, rows, columns))[0]
                if names == ("eyes",) and config.eyes_box is not None:
                    picture = self._on_background(picture, opacity.reshape(rows, columns))
                images[part] = to_picture(picture, camera)
                geometry[part] = GeometryView(
                    grid.camera, opacity.reshape(rows, columns).numpy(), distance.reshape(rows, columns).numpy()
                )
        return RenderedView(camera, images, geometry)

    def _on_background(self, picture: torch.Tensor, opacity: torch.Tensor) -> torch.Tensor:
        """A picture (3, H, W) where a feature map's opacity (h, w) or a neighbour's is, else the background."""
        grown = F.max_pool2d(opacity[None, None].float(), 3, stride=1, padding=1)
        share = F.interpolate(grown, size=picture.shape[1:], mode="bilinear", align_corners=False)[0]
        return share * picture + (1.0 - share) * torch.from_numpy(self.background)[:, None, None]

    def render_geometry(self, camera: Camera, part: Part = "head", normals: bool = False) -> GeometryView:
        """Opacity and expected depth along the rays of every pixel; for `head`, of both media as one.

        With `normals`, minus the direction in which density grows at the surface.
        """
        names = self._streams_of(part)
        rays_o, rays_d = camera_rays(camera)
        opacity, depth = torch.zeros(len(rays_o)), torch.full((len(rays_o),), torch.nan)
        with self._fast():
            if self.sparse:
                distance, hit = self._surface(rays_o, rays_d, names)
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
