"""Pictures and geometry of a head at one gaze, sampled around its surface where it has one."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch
import torch.nn.functional as F

from gazenerf.errors import UserError
from gazenerf.field.compositing import Composited, composite, composite_stream, composite_streams
from gazenerf.field.sampling import RaySamples, ray_samples, shell_samples, slab_samples
from gazenerf.geometry import Camera, camera_rays
from gazenerf.head_model.follow import codes_at
from gazenerf.heads.cutouts import cut_outs_of
from gazenerf.heads.details import detailed
from gazenerf.heads.feature_map import FeatureGrid, RayFeatures, Window, add_behind, to_picture
from gazenerf.heads.interface import OPACITY_FLOOR, GeometryView, Part, RenderedView

if TYPE_CHECKING:
    from gazenerf.heads.bound import BoundHead

SLAB_SLOPE = 0.5
"""Slabs are used while |d_z| of every ray exceeds this: cameras up to about 50 degrees from the front."""

SHALLOW = 0.9
"""Opacity that a shell around a surface has on most rays; haze has less, and needs even samples."""

SHELL_FRONT, SHELL_LEFT = 6, 5e-3
"""Samples of a shell queried at first, and the share of light below which the others are not."""

EVEN_FRONT, EVEN_LEFT = 16, 1e-6
"""The same for even samples, whose picture must stay the published one to rounding."""

WINDOW = (0.06, 0.09)
"""World units before and behind a surface known at one gaze in which it is looked for at another."""

GEOMETRY_SHELL, GEOMETRY_SAMPLES = 0.06, 16
"""Half width of the shell, world units, and samples per ray where only opacity and depth are wanted."""


def render_parts(bound: BoundHead, camera: Camera, parts: tuple[Part, ...], cutouts: bool = False) -> RenderedView:
    """See `BoundHead.render`, and `BoundHead.render_cut_out` for `cutouts`."""
    for part in parts:
        bound.streams_of(part)
    field, config = bound.field, bound.field.config
    grid = FeatureGrid.of(camera, config, bound.head.device)
    images: dict[Part, np.ndarray] = {}
    geometry: dict[Part, GeometryView] = {}
    alone: dict[Part, np.ndarray] = {}
    with bound.head.quickly():
        background = field.renderer.background(*grid.shape)[0].flatten(1).T.float()
        cache: dict[tuple[str, ...], RayFeatures] = {}
        for part in parts:
            seen = _part_features(bound, grid, background, part, cache)
            turned = part != "face" and (len(bound.streams_of(part)) == 1 or config.merge == "max")
            uncut = bound.head.painter.uncut(seen, grid.shape, turned)
            uncut = detailed([bound], uncut, grid, seen, part)
            picture = uncut if turned else bound.head.painter.cut(uncut, seen, grid.shape)
            if cutouts:
                alone[part] = to_picture(_cut_out(bound, grid, seen, background, part, uncut), camera)
            if part == "eyes" and config.eyes_box is not None:
                picture = _on_background(bound, picture, seen.opacity.reshape(grid.shape))
            images[part] = to_picture(picture, camera)
            geometry[part] = grid.geometry(seen)[0]
    return RenderedView(camera, images, geometry, alone)


def _cut_out(
    bound: BoundHead, grid: FeatureGrid, seen: RayFeatures, background: torch.Tensor, part: Part, uncut: torch.Tensor
) -> torch.Tensor:
    """(4, H, W) of a part; see `cut_outs_of`. What is behind it is what its empty rays see."""
    head, config = bound.head, bound.field.config
    behind = background
    if part == "eyes" or (part == "head" and len(bound.streams_of(part)) == 1):
        behind = bound.turn(background)
    elif part == "head" and config.merge == "max":
        behind = torch.maximum(background, bound.turn(background))
    if seen.matte is None and seen.outline is not None:  # mixed with what is behind it in the picture, not in a cutout
        seen = grid.with_matte(seen, behind)
        uncut = head.painter.uncut(seen, grid.shape, turned=True)
        uncut = detailed([bound], uncut, grid, seen, part)
    picture_behind = head.painter.upsample(behind.T.reshape(1, -1, *grid.shape))[0] if seen.matte is None else uncut
    return cut_outs_of(seen, uncut, picture_behind, grid.shape)[0]


def _part_features(
    bound: BoundHead,
    grid: FeatureGrid,
    background: torch.Tensor,
    part: Part,
    cache: dict[tuple[str, ...], RayFeatures],
) -> RayFeatures:
    """A part's feature map, merged as the field was trained; `cache` holds what several parts share."""

    def of(streams: tuple[str, ...]) -> RayFeatures:
        if streams not in cache:
            cache[streams] = _feature_map(bound, grid, streams, background)
        return cache[streams]

    streams = bound.streams_of(part)
    if len(streams) > 1 and bound.field.config.merge == "max":
        face, eyes = of(("face",)), of(("eyes",))
        opacity = 1.0 - (1.0 - face.opacity) * (1.0 - eyes.opacity)
        features = torch.maximum(face.features, eyes.features)
        return RayFeatures(features, opacity, torch.fmin(face.distance, eyes.distance))
    seen = of(streams)
    if streams == ("head",):
        return seen._replace(features=bound.turn(seen.features))
    return seen


def _feature_map(
    bound: BoundHead, grid: FeatureGrid, streams: tuple[str, ...], background: torch.Tensor
) -> RayFeatures:
    sparse = bound.head.sparse
    found = composite_rays(bound, grid.rays_o, grid.rays_d, streams, background, sparse=sparse)
    if not sparse:  # outlines of published fields are left as they are
        return found
    if is_hazy(found.opacity):
        share = float(found.opacity[found.opacity > 0].median())
        bound.head.warn_dense(f"a shell around the surface holds {share:.0%} of what is seen")
        return composite_rays(bound, grid.rays_o, grid.rays_d, streams, background, sparse=False)
    found = _with_what_is_behind(bound, found, grid.rays_o, grid.rays_d, streams, background)
    return grid.smooth_outline(
        lambda rays_o, rays_d, behind, window, _: _solid_rays(bound, rays_o, rays_d, streams, behind, window),
        background,
        found,
        cut=streams != ("eyes",) and bound.field.config.merge == "joint",
    )


def is_hazy(opacity: torch.Tensor) -> bool:
    """Do shells around the surfaces of a picture's rays (R,) hold too little of what is seen, so that it is haze?"""
    seen = opacity[opacity > 0]
    return len(seen) > 0 and float(seen.median()) < SHALLOW


def _on_background(bound: BoundHead, picture: torch.Tensor, opacity: torch.Tensor) -> torch.Tensor:
    """A picture (3, H, W) where a feature map's opacity (h, w) or a neighbour's is, else the background."""
    grown = F.max_pool2d(opacity[None, None].float(), 3, stride=1, padding=1)
    share = F.interpolate(grown, size=picture.shape[1:], mode="bilinear", align_corners=False)[0]
    background = torch.from_numpy(bound.background).to(picture.device)
    return share * picture + (1.0 - share) * background[:, None, None]


# Along rays


def composite_near(
    bound: BoundHead, rays_o: torch.Tensor, rays_d: torch.Tensor, distance: torch.Tensor, background: torch.Tensor
) -> RayFeatures:
    """The head along rays whose surface is known to lie near a distance (R,); see `WINDOW`."""
    with bound.head.quickly():
        window = distance - WINDOW[0], distance + WINDOW[1]
        return _solid_rays(bound, rays_o, rays_d, tuple(bound.field.streams), background, window)


def composite_rays(
    bound: BoundHead,
    rays_o: torch.Tensor,
    rays_d: torch.Tensor,
    streams: tuple[str, ...],
    background: torch.Tensor,
    window: Window | None = None,
    sparse: bool = True,
) -> RayFeatures:
    """Streams as one medium along rays; where they are sampled around a surface, the first one only.

    Args:
        rays_o, rays_d: (R, 3).
        streams: Of the field; `("eyes",)` alone are turned with their background, as published.
        background: (R, C) features behind.
        window: Nearest and farthest distance (R,) at which a surface is looked for.
        sparse: Sample around a surface only; evenly otherwise.
    """
    alone = streams == ("eyes",)
    background = bound.turn(background) if alone else background
    features, opacity = background.clone(), rays_o.new_zeros(len(rays_o))
    distance, end = rays_o.new_full((2, len(rays_o)), torch.nan)
    rays, samples = _sampled(bound, rays_o, rays_d, streams, window, sparse)
    front, left = (SHELL_FRONT, SHELL_LEFT) if sparse else (EVEN_FRONT, EVEN_LEFT)
    for index, t, deltas in _chunks(rays, samples, bound.head.chunk):
        points = rays_o[index, None] + t[..., None] * rays_d[index, None]
        rows, alpha, expected = _front_to_back(bound, points, RaySamples(t, deltas), streams, front, left)
        rows = bound.turn(rows) if alone else rows
        features[index] = rows + (1.0 - alpha[:, None]) * background[index]
        opacity[index] = alpha
        distance[index] = torch.where(alpha >= OPACITY_FLOOR, expected, torch.nan)
        end[index] = t[:, -1] + 0.5 * deltas[:, -1]
    return RayFeatures(features, opacity, distance, end)


def _solid_rays(
    bound: BoundHead,
    rays_o: torch.Tensor,
    rays_d: torch.Tensor,
    streams: tuple[str, ...],
    background: torch.Tensor,
    window: Window | None = None,
) -> RayFeatures:
    """`composite_rays`, and a second surface where the first one lets light through."""
    front = composite_rays(bound, rays_o, rays_d, streams, background, window)
    return _with_what_is_behind(bound, front, rays_o, rays_d, streams, background)


def _with_what_is_behind(
    bound: BoundHead,
    front: RayFeatures,
    rays_o: torch.Tensor,
    rays_d: torch.Tensor,
    streams: tuple[str, ...],
    background: torch.Tensor,
) -> RayFeatures:
    """What `composite_rays` gave, in place with a second surface where the first one lets light through."""

    def look(rays: torch.Tensor, where: Window) -> RayFeatures:
        return composite_rays(bound, rays_o[rays], rays_d[rays], streams, background[rays], where)

    return add_behind(front, bound.turn(background) if streams == ("eyes",) else background, look)


def _chunks(rays: torch.Tensor, samples: RaySamples, most: int):
    """Rays (A,) with their samples, so many at a time that `most` points are queried at once."""
    size = max(1, most // max(1, samples.t.shape[1] if len(rays) else 1))
    return zip(rays.split(size), samples.t.split(size), samples.deltas.split(size), strict=True)


def _sampled(
    bound: BoundHead,
    rays_o: torch.Tensor,
    rays_d: torch.Tensor,
    streams: tuple[str, ...],
    window: Window | None,
    sparse: bool,
) -> tuple[torch.Tensor, RaySamples]:
    """Numbers of the rays that can hit something, and their samples."""
    config = bound.field.config
    if not sparse:
        return torch.arange(len(rays_o), device=rays_o.device), _even_samples(bound, rays_o, rays_d)
    distance, hit = bound.surface(rays_o, rays_d, streams, window)
    rays = hit.nonzero()[:, 0]
    return rays, shell_samples(distance[rays], config.shell, config.shell_samples)


def _even_samples(bound: BoundHead, rays_o: torch.Tensor, rays_d: torch.Tensor) -> RaySamples:
    """The published slabs where every ray descends steeply in z, else as many steps through the box.

    Slabs are undefined for rays at right angles to z and in the wrong order from behind.
    """
    if bool((rays_d[:, 2] < -SLAB_SLOPE).all()):
        return slab_samples(rays_o, rays_d, bound.field.config)
    box = torch.from_numpy(bound.box.astype(np.float32)).to(rays_o.device)
    return ray_samples(rays_o, rays_d, box, bound.field.config.samples)


def _front_to_back(
    bound: BoundHead, points: torch.Tensor, samples: RaySamples, streams: tuple[str, ...], front: int, left: float
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """`front` samples at a time, on with the rays that have more than `left` of their light.

    What lies behind a segment of a ray is added times the light that passes the segment.

    Args:
        points: (R, S, 3) of the samples.

    Returns:
        features (R, C) without background, opacity (R,), expected distance (R,).
    """
    t, deltas = samples
    seen = _segment(bound, points[:, :front], deltas[:, :front], streams)
    rows, opacity = seen.features, seen.opacity
    expected = (seen.weights * t[:, :front]).sum(-1) / opacity.clamp(min=1e-6)
    if t.shape[1] <= front:
        return rows, opacity, expected
    on = (1.0 - opacity > left).nonzero()[:, 0]
    if len(on):
        rest = RaySamples(t[on, front:], deltas[on, front:])
        behind = _front_to_back(bound, points[on, front:], rest, streams, front, left)
        passed = 1.0 - opacity[on]
        near, far = opacity[on], passed * behind[1]
        rows[on] += passed[:, None] * behind[0]
        expected[on] = (near * expected[on] + far * behind[2]) / (near + far).clamp(min=1e-6)
        opacity[on] = near + far
    return rows, opacity, expected


def _segment(bound: BoundHead, points: torch.Tensor, deltas: torch.Tensor, streams: tuple[str, ...]) -> Composited:
    """Streams along segments of rays; the eyes are queried only on rays that can meet them."""
    first = bound.samples(streams[0], points)
    near = bound.near_eyes(points).any(-1) if len(streams) > 1 else None
    if near is None or not bool(near.any()):
        return composite_stream(first, deltas)
    if bool(near.all()):
        return composite_streams(first, bound.samples("eyes", points), deltas, bound.turn)
    joint = composite_streams(first.rays(near), bound.samples("eyes", points[near]), deltas[near], bound.turn)
    alone = composite_stream(first.rays(~near), deltas[~near])
    features = joint.features.new_empty(len(points), joint.features.shape[-1])
    weights, opacity = torch.empty_like(deltas), deltas.new_empty(len(points))
    for where, part in ((near, joint), (~near, alone)):
        features[where], opacity[where], weights[where] = part.features, part.opacity, part.weights
    return Composited(features, opacity, weights)


# Geometry and the published pass


def render_geometry(bound: BoundHead, camera: Camera, part: Part, normals: bool) -> GeometryView:
    """See `BoundHead.render_geometry`."""
    streams = bound.streams_of(part)
    rays_o, rays_d = camera_rays(camera, device=bound.head.device)
    opacity, depth = rays_o.new_zeros(len(rays_o)), rays_o.new_full((len(rays_o),), torch.nan)
    with bound.head.quickly():
        if bound.head.sparse:
            distance, hit = bound.surface(rays_o, rays_d, streams)
            rays = hit.nonzero()[:, 0]
            samples = shell_samples(distance[rays], GEOMETRY_SHELL, GEOMETRY_SAMPLES)
        else:
            rays, samples = torch.arange(len(rays_o), device=rays_o.device), _even_samples(bound, rays_o, rays_d)
        for index, t, deltas in _chunks(rays, samples, bound.head.chunk):
            points = rays_o[index, None] + t[..., None] * rays_d[index, None]
            density = bound.density_of(streams, points.reshape(-1, 3)).reshape(t.shape)
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
        vectors[seen.reshape(shape).cpu().numpy()] = bound.normals(at, part).cpu().numpy()
    return GeometryView(camera, opacity.reshape(shape).cpu().numpy(), depth.reshape(shape).cpu().numpy(), vectors)


def published_pass(bound: BoundHead, camera: Camera) -> dict[str, torch.Tensor]:
    """See `BoundHead.render_slow`."""
    if not bool((camera_rays(camera.resized(8))[1][:, 2] < -SLAB_SLOPE).all()):
        raise UserError("the published path needs a camera in front of the head; use render for other views")
    head, codes = bound.head, codes_at(bound.subject.codes, bound.gaze)
    small = camera.resized(bound.field.config.feature_size)

    def tensor(array: np.ndarray) -> torch.Tensor:
        return torch.from_numpy(array.astype(np.float32))[None].to(head.device)

    pose = small.world_from_camera
    with head.exactly():
        return bound.field.published_forward(
            tensor(codes.shape_code),
            tensor(codes.appearance_code),
            bound.label,
            tensor(pose[:3, :3]),
            tensor(pose[:3, 3:]),
            tensor(np.linalg.inv(small.intrinsics)),
        )
