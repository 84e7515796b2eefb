"""What a batch's rays say about geometry: differentiable terms for the density of both streams, or of the only one."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from gazenerf.field.compositing import Composited
from gazenerf.field.model import TwoStreamField
from gazenerf.field.streams import StreamCondition
from gazenerf.training.batches import Batch
from gazenerf.training.losses import shared_count

FREE_MARGIN = 0.08
"""World units in front of a captured surface that may hold density."""

FREE_REACH = 0.5
"""Light that passes a surface counts as landing half this far from it, world units."""

SCENE_RADIUS = 2.2
"""World units around the origin that are asked to be empty where nothing was captured."""

FRONT, BEHIND, SOLID = 0.03, (0.015, 0.12), 40.0
"""World units in front of a captured surface that are empty, the layer behind it that is solid, and
the density per world unit demanded in that layer."""

EYE_OUTSIDE, EYE_INSIDE = 1.15, 0.97
"""In eyeball radii: density beyond the first (the cornea bulges) is penalised, within the second demanded."""

EYE_DENSITY = 40.0
"""Density per world unit demanded inside an eyeball."""


@dataclass(frozen=True)
class TwoStreamRays:
    """Both streams along the rays of a batch, B images of R rays of which E pass near an eye.

    Attributes:
        t: (B, R, S) distances of the samples, world units.
        density: (B, R, S) of the face stream.
        face: The face stream alone along all rays.
        joint: Both streams as one medium along the rays near an eye, (B, E).
        face_condition, eyes_condition: Of the streams.
    """

    t: torch.Tensor
    density: torch.Tensor
    face: Composited
    joint: Composited
    face_condition: StreamCondition
    eyes_condition: StreamCondition


@dataclass(frozen=True)
class OneStreamRays:
    """The only stream of a field along the rays of a batch, B images of R rays.

    Attributes:
        t: (B, R, S) distances of the samples, world units.
        density: (B, R, S).
        head: The stream along all rays.
        condition: Of the stream.
    """

    t: torch.Tensor
    density: torch.Tensor
    head: Composited
    condition: StreamCondition


def mean_over(values: torch.Tensor, mask: torch.Tensor) -> torch.Tensor:
    """Mean of `values` where `mask`, 0 where the mask is empty."""
    weight = mask.to(values.dtype)
    return (values * weight).sum() / shared_count(weight.sum()).clamp(min=1.0)


def pick(values: torch.Tensor, index: torch.Tensor) -> torch.Tensor:
    """values (B, R, ...) at index (B, E) -> (B, E, ...)."""
    shape = index.shape + (1,) * (values.dim() - 2)
    return values.gather(1, index.reshape(shape).expand(*index.shape, *values.shape[2:]))


def geometry_terms(model: TwoStreamField, batch: Batch, rays: TwoStreamRays) -> dict[str, torch.Tensor]:
    """Unweighted scalar losses `depth`, `surface`, `opacity`, `empty` and, where eyeballs are known, `eyeball`."""
    face, joint = rays.face, rays.joint
    assert joint.weights_eyes is not None
    near_eye = torch.zeros_like(batch.valid).scatter(1, batch.eye_rays, batch.eye_valid)
    plain = batch.valid & ~near_eye
    gap = rays.t - batch.distance[..., None]
    eye_gap = pick(rays.t, batch.eye_rays) - pick(batch.distance, batch.eye_rays)[..., None]
    eye_surface = pick(batch.has_surface, batch.eye_rays) & batch.eye_valid
    surface = plain & batch.has_surface
    eyes_opacity = joint.weights_eyes.sum(-1)
    face_opacity = (joint.weights - joint.weights_eyes).sum(-1)
    face_cover, eyes_cover = pick(batch.face_coverage, batch.eye_rays), pick(batch.eyes_coverage, batch.eye_rays)
    terms = {
        "depth": mean_over(_miss(face, gap), surface) + 0.2 * mean_over(_miss(joint, eye_gap), eye_surface),
        "surface": _surface_term(rays.density, gap, surface),
        "opacity": mean_over((face.opacity - batch.face_coverage).abs(), plain)
        + 0.2 * mean_over((face_opacity - face_cover).abs() + (eyes_opacity - eyes_cover).abs(), batch.eye_valid),
        "empty": _empty_term(model, batch, {"face": rays.face_condition, "eyes": rays.eyes_condition}),
    }
    if batch.eye_centres is not None:
        terms["eyeball"] = _eyeball_term(model, batch, rays.eyes_condition)
    return terms


def one_stream_terms(model: TwoStreamField, batch: Batch, rays: OneStreamRays) -> dict[str, torch.Tensor]:
    """Unweighted scalar losses `depth`, `surface`, `opacity` and `empty` of a field with one stream.

    Face and eyes are one surface to it, so there is nothing to say of eyeballs behind lids.
    """
    gap = rays.t - batch.distance[..., None]
    surface = batch.valid & batch.has_surface
    covered = batch.face_coverage + batch.eyes_coverage
    return {
        "depth": mean_over(_miss(rays.head, gap), surface),
        "surface": _surface_term(rays.density, gap, surface),
        "opacity": mean_over((rays.head.opacity - covered).abs(), batch.valid),
        "empty": _empty_term(model, batch, {"head": rays.condition}),
    }


def _miss(seen: Composited, gap: torch.Tensor) -> torch.Tensor:
    """(B, .) how far from the captured surface light lands, for samples (B, ., S) that are `gap` behind it."""
    return (seen.weights * gap.abs()).sum(-1) + 0.5 * FREE_REACH * (1.0 - seen.opacity)


def _surface_term(density: torch.Tensor, gap: torch.Tensor, surface: torch.Tensor) -> torch.Tensor:
    """Empty in front and solid behind, of densities (B, R, S) that are `gap` behind, on rays (B, R) with a surface."""
    front = (gap < -FRONT) & surface[..., None]
    behind = (gap > BEHIND[0]) & (gap < BEHIND[1]) & surface[..., None]
    solid = (SOLID - density).clamp(min=0.0)
    return mean_over(density, front) / SOLID + mean_over(solid, behind) / SOLID


def _empty_term(model: TwoStreamField, batch: Batch, conditions: dict[str, StreamCondition]) -> torch.Tensor:
    """Mean density of the streams where the captures saw nothing, summed."""
    origin = batch.rays_o[:, :1]
    middle = origin.norm(dim=-1)
    far = torch.minimum(batch.free_limit - FREE_MARGIN, middle + SCENE_RADIUS)
    near = middle - SCENE_RADIUS
    t = near + (far - near).clamp(min=0.0) * torch.rand_like(far)
    points = origin + t[..., None] * batch.free_d
    found = [model.stream(name).query(points, known, features=False)[0] for name, known in conditions.items()]
    return torch.stack([density.mean() for density in found]).sum()


def _eyeball_term(
    model: TwoStreamField, batch: Batch, eyes_condition: StreamCondition, count: int = 512
) -> torch.Tensor:
    """The eyes stream is dense inside both eyeballs and empty outside them."""
    assert batch.eye_centres is not None
    centres, radius = batch.eye_centres, batch.eye_radius
    b = centres.shape[0]
    direction = torch.randn(b, count, 3, device=centres.device)
    direction = direction / direction.norm(dim=-1, keepdim=True)
    distance = radius * 2.5 * torch.rand(b, count, 1, device=centres.device)
    points = centres[:, torch.arange(count, device=centres.device) % 2] + direction * distance
    wide = SCENE_RADIUS * (2 * torch.rand(b, count // 4, 3, device=centres.device) - 1)
    points = torch.cat([points, wide], dim=1)
    nearest = (points[:, :, None] - centres[:, None]).norm(dim=-1).amin(-1) / radius
    density = model.stream("eyes").query(points, eyes_condition, features=False)[0]
    outside = mean_over(density, nearest > EYE_OUTSIDE)
    inside = mean_over((EYE_DENSITY - density).clamp(min=0.0), nearest < EYE_INSIDE)
    return outside + inside
