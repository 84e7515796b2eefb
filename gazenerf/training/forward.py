"""One differentiable pass over a batch: feature maps, pictures and the terms about geometry."""

from __future__ import annotations

from dataclasses import dataclass, field

import torch

from gazenerf.field.compositing import composite, composite_joint
from gazenerf.field.eye_motion import rotate_features
from gazenerf.field.model import TwoStreamField
from gazenerf.field.sampling import shell_samples, slab_samples
from gazenerf.field.streams import StreamCondition
from gazenerf.training.batches import EYE_CROP, Batch

FREE_MARGIN = 0.08
"""World units in front of a captured surface that may hold density."""

FREE_REACH = 0.5
"""Light that passes a surface counts as landing half this far from it, world units."""

SCENE_RADIUS = 2.2
"""World units around the origin that are asked to be empty where nothing was captured."""

FRONT, BEHIND, SOLID = 0.03, (0.015, 0.12), 40.0
"""World units in front of a captured surface that are empty, the layer behind it that is solid, and
the density per world unit asked for in that layer."""

EYE_OUTSIDE, EYE_INSIDE = 1.15, 0.97
"""In eyeball radii: density beyond the first (the cornea bulges) is penalised, within the second asked for."""

EYE_DENSITY = 40.0
"""Density per world unit asked for inside an eyeball."""


@dataclass
class TrainingRender:
    """Pictures of a batch and its geometry terms.

    Attributes:
        image: (B, 3, H, W) the merged picture.
        eyes_image: (B, 3, h, w) the eyes stream on its crop, or None.
        eyes_window: (B, 2) row and column of that crop in picture pixels.
        face_image: (B, 3, H, W) the face stream, or None when not asked for.
        terms: Unweighted scalar losses `depth`, `surface`, `opacity`, `empty`, `eyeball` that apply.
    """

    image: torch.Tensor
    eyes_image: torch.Tensor | None
    eyes_window: torch.Tensor
    face_image: torch.Tensor | None
    terms: dict[str, torch.Tensor] = field(default_factory=dict)


def mean_over(values: torch.Tensor, mask: torch.Tensor) -> torch.Tensor:
    """Mean of `values` where `mask`, 0 where the mask is empty."""
    weight = mask.to(values.dtype)
    return (values * weight).sum() / weight.sum().clamp(min=1.0)


def _blend(weights: torch.Tensor, hidden: torch.Tensor) -> torch.Tensor:
    """Weighted sums (B, R, K) of hidden features (B, R, S, K), in their precision."""
    return (weights.to(hidden.dtype).unsqueeze(-2) @ hidden).squeeze(-2)


def _pick(values: torch.Tensor, index: torch.Tensor) -> torch.Tensor:
    """values (B, R, ...) at index (B, E) -> (B, E, ...)."""
    shape = index.shape + (1,) * (values.dim() - 2)
    return values.gather(1, index.reshape(shape).expand(*index.shape, *values.shape[2:]))


def _put(target: torch.Tensor, index: torch.Tensor, values: torch.Tensor) -> torch.Tensor:
    """target (B, N, C) with rows `index` (B, R) replaced by values (B, R, C), out of place."""
    return target.scatter(1, index.unsqueeze(-1).expand_as(values), values)


def render_batch(
    model: TwoStreamField,
    batch: Batch,
    *,
    shell: float | None,
    samples: int,
    noise: float = 0.0,
    jitter: bool = True,
    face_image: bool = False,
    eyes_image: bool = True,
    geometry: bool = True,
) -> TrainingRender:
    """Render a batch through the rays it lists (paper Sec. 3.2).

    Args:
        model: Its streams are `face` and `eyes`, or one `head`.
        shell: Half width of the samples around the captured surface; None for the published slabs.
        samples: Samples a ray in the shell.
        noise: Standard deviation of the shell's centre, world units.
        jitter: Stratified samples; the middle of each interval otherwise.
        face_image, eyes_image: Render the streams' own pictures too.
        geometry: Compute the geometry terms (needs captured depth).
    """
    config = model.config
    b, r = batch.rays.shape
    size = config.feature_size
    label = batch.gaze * batch.gaze.new_tensor(config.gaze_label_signs)
    if shell is None:
        t, deltas = slab_samples(batch.rays_o.reshape(-1, 3), batch.rays_d.reshape(-1, 3), config, jitter)
    else:
        centre = batch.distance.reshape(-1)
        if noise > 0:
            centre = centre + noise * torch.randn_like(centre)
        t, deltas = shell_samples(centre, shell, samples, jitter)
    t, deltas = t.reshape(b, r, -1), deltas.reshape(b, r, -1)
    points = batch.rays_o[:, :, None] + t[..., None] * batch.rays_d[:, :, None]

    two = config.streams == "two"
    face = model.stream("face" if two else "head")
    face_condition = face.condition(batch.shape_code, batch.appearance_code, label)
    density_face, hidden_face = face.query(points, face_condition)
    weights_face, opacity_face = composite(density_face, deltas)
    features = face.project(_blend(weights_face, hidden_face), opacity_face).float()
    background = model.renderer.background(size, size).float().flatten(2).transpose(1, 2).expand(b, -1, -1)

    def full_map(rows: torch.Tensor, opacity: torch.Tensor, index: torch.Tensor) -> torch.Tensor:
        return _put(background, index, rows + (1.0 - opacity[..., None]) * _pick(background, index))

    def picture(feature_map: torch.Tensor, height: int = size, width: int = size) -> torch.Tensor:
        return model.renderer(feature_map.transpose(1, 2).reshape(b, -1, height, width)).float()

    face_map = full_map(features, opacity_face, batch.rays)
    terms: dict[str, torch.Tensor] = {}
    scale = config.image_size // size
    window = batch.eye_corner * scale
    if not two:
        if config.eye_motion == "feature_rotation":
            face_map = rotate_features(face_map, label[:, None, :])
        return TrainingRender(picture(face_map), None, window, None, terms)

    eye_flat = batch.rays.gather(1, batch.eye_rays)
    t_eyes, deltas_eyes = _pick(t, batch.eye_rays), _pick(deltas, batch.eye_rays)
    eyes = model.stream("eyes")
    eyes_condition = eyes.condition(batch.shape_code, batch.appearance_code, label)
    eye_points = _pick(points, batch.eye_rays)
    density_eyes, hidden_eyes = model.query("eyes", eye_points, eyes_condition)
    weights_eyes, opacity_eyes = composite(density_eyes, deltas_eyes)
    rotate = config.eye_motion == "feature_rotation"

    def turned(rows: torch.Tensor) -> torch.Tensor:
        return rotate_features(rows, label[:, None, :]) if rotate else rows

    eyes_rows = eyes.project(_blend(weights_eyes, hidden_eyes), opacity_eyes).float()
    eyes_map = turned(full_map(eyes_rows, opacity_eyes, eye_flat))
    joint_face, joint_eyes, joint_opacity = composite_joint(
        _pick(density_face, batch.eye_rays), density_eyes, deltas_eyes
    )
    if config.merge == "joint":
        hidden_near = _pick(hidden_face, batch.eye_rays)
        rows = face.project(_blend(joint_face, hidden_near), joint_face.sum(-1)).float()
        rows = rows + turned(eyes.project(_blend(joint_eyes, hidden_eyes), joint_eyes.sum(-1)).float())
        rows = rows + (1.0 - joint_opacity[..., None]) * _pick(background, eye_flat)
        merged = _put(face_map, eye_flat, rows)
    else:
        merged = torch.maximum(face_map, eyes_map)

    eyes_picture = None
    if eyes_image:
        height, width = min(EYE_CROP[0], size), min(EYE_CROP[1], size)
        rows = batch.eye_corner[:, :1] + torch.arange(height, device=t.device)
        columns = batch.eye_corner[:, 1:] + torch.arange(width, device=t.device)
        crop = (rows[:, :, None] * size + columns[:, None, :]).reshape(b, -1)
        eyes_picture = picture(_pick(eyes_map, crop), height, width)
    if geometry:
        near_eye = torch.zeros_like(batch.valid).scatter(1, batch.eye_rays, batch.eye_valid)
        plain = batch.valid & ~near_eye
        joint = joint_face + joint_eyes
        lost = 0.5 * FREE_REACH
        miss = (weights_face * (t - batch.distance[..., None]).abs()).sum(-1) + lost * (1.0 - opacity_face)
        eye_distance = _pick(batch.distance, batch.eye_rays)
        miss_eyes = (joint * (t_eyes - eye_distance[..., None]).abs()).sum(-1) + lost * (1.0 - joint_opacity)
        eye_surface = _pick(batch.has_surface, batch.eye_rays) & batch.eye_valid
        surface = plain & batch.has_surface
        terms["depth"] = mean_over(miss, surface) + 0.2 * mean_over(miss_eyes, eye_surface)
        gap = t - batch.distance[..., None]
        front, behind = (gap < -FRONT) & surface[..., None], (gap > BEHIND[0]) & (gap < BEHIND[1]) & surface[..., None]
        terms["surface"] = (
            mean_over(density_face, front) / SOLID + mean_over((SOLID - density_face).clamp(min=0.0), behind) / SOLID
        )
        face_cover, eyes_cover = _pick(batch.face_coverage, batch.eye_rays), _pick(batch.eyes_coverage, batch.eye_rays)
        terms["opacity"] = mean_over((opacity_face - batch.face_coverage).abs(), plain) + 0.2 * mean_over(
            (joint_face.sum(-1) - face_cover).abs() + (joint_eyes.sum(-1) - eyes_cover).abs(), batch.eye_valid
        )
        terms["empty"] = _empty_term(model, batch, face_condition, eyes_condition)
        if batch.eye_centres is not None:
            terms["eyeball"] = _eyeball_term(model, batch, eyes_condition)
    return TrainingRender(picture(merged), eyes_picture, window, picture(face_map) if face_image else None, terms)


def _empty_term(
    model: TwoStreamField, batch: Batch, face_condition: StreamCondition, eyes_condition: StreamCondition
) -> torch.Tensor:
    """Mean density of both streams where the captures saw nothing."""
    origin = batch.rays_o[:, :1]
    middle = origin.norm(dim=-1)
    far = torch.minimum(batch.free_limit - FREE_MARGIN, middle + SCENE_RADIUS)
    near = middle - SCENE_RADIUS
    t = near + (far - near).clamp(min=0.0) * torch.rand_like(far)
    points = origin + t[..., None] * batch.free_d
    face = model.stream("face").query(points, face_condition, features=False)[0]
    eyes = model.stream("eyes").query(points, eyes_condition, features=False)[0]
    return face.mean() + eyes.mean()


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
