"""One differentiable pass over a batch: feature maps, pictures and the terms about geometry."""

from __future__ import annotations

from dataclasses import dataclass, field

import torch

from gazenerf.field.compositing import Composited, StreamSamples, composite_stream, composite_streams
from gazenerf.field.model import TwoStreamField
from gazenerf.field.sampling import RaySamples, shell_samples, slab_samples
from gazenerf.training.batches import Batch
from gazenerf.training.geometry_terms import OneStreamRays, TwoStreamRays, geometry_terms, one_stream_terms, pick
from gazenerf.training.operations import REFERENCE, Operations
from gazenerf.training.ray_targets import eye_crop
from gazenerf.training.surface_samples import surface_samples


@dataclass
class TrainingRender:
    """Pictures of a batch and its geometry terms.

    Attributes:
        image: (B, 3, H, W) the merged picture.
        eyes_image: (B, 3, h, w) the eyes stream on its crop, or None.
        eyes_window: (B, 2) row and column of that crop in picture pixels, of the batch's window where it has one.
        face_image: (B, 3, H, W) the face stream, or None when not rendered.
        terms: Unweighted scalar losses `depth`, `surface`, `opacity`, `empty`, `eyeball` that apply.
    """

    image: torch.Tensor
    eyes_image: torch.Tensor | None
    eyes_window: torch.Tensor
    face_image: torch.Tensor | None
    terms: dict[str, torch.Tensor] = field(default_factory=dict)


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
    operations: Operations = REFERENCE,
) -> TrainingRender:
    """Render a batch through the rays it lists (paper Sec. 3.2).

    Args:
        model: Its streams are `face` and `eyes`, or one `head`.
        shell: Half width of the samples around the captured surface, or around the field's own where it knows
            distances; None for the published slabs.
        samples: Samples per ray in the shell.
        noise: Standard deviation of the captured surface's place, world units; of fields of densities.
        jitter: Stratified samples; the middle of each interval otherwise.
        face_image, eyes_image: Render the streams' own pictures too.
        geometry: Compute the geometry terms (needs captured depth).
        operations: How pictures are drawn from feature maps.
    """
    maps = _Maps(model, batch, operations)
    conditions = {
        name: model.condition(name, batch.shape_code, batch.appearance_code, maps.label) for name in model.streams
    }
    if shell is not None and model.config.geometry == "distance":
        t, deltas = surface_samples(model, batch, conditions, shell, samples, jitter)
    else:
        t, deltas = _samples(model, batch, shell, samples, noise, jitter)
    points = batch.rays_o[:, :, None] + t[..., None] * batch.rays_d[:, :, None]
    window = torch.zeros_like(batch.eye_corner)
    if batch.window is None:
        window = batch.eye_corner * (model.config.image_size // maps.size)

    first = "face" if model.config.streams == "two" else "head"
    face = model.samples(first, points, conditions[first])
    face_alone = composite_stream(face, deltas)
    face_map = maps.whole(face_alone, batch.rays)
    if first == "head":
        known = OneStreamRays(t, face.density, face_alone, conditions["head"])
        terms = one_stream_terms(model, batch, known) if geometry else {}
        return TrainingRender(maps.pictures(maps.turn(face_map), None)[0], None, window, None, terms)

    eyes = model.samples("eyes", pick(points, batch.eye_rays), conditions["eyes"])
    eye_deltas, eye_pixels = pick(deltas, batch.eye_rays), batch.rays.gather(1, batch.eye_rays)
    eyes_map = maps.whole(composite_stream(eyes, eye_deltas), eye_pixels)
    face_near = StreamSamples(pick(face.density, batch.eye_rays), pick(face.features, batch.eye_rays), face.project)
    joint = composite_streams(face_near, eyes, eye_deltas, maps.turn)
    if model.config.merge == "joint":
        merged = _put(face_map, eye_pixels, joint.over(pick(maps.background, eye_pixels)))
    else:
        eyes_map = maps.turn(eyes_map)
        merged = torch.maximum(face_map, eyes_map)

    terms: dict[str, torch.Tensor] = {}
    if geometry:
        rays = TwoStreamRays(t, face.density, face_alone, joint, conditions["face"], conditions["eyes"])
        terms = geometry_terms(model, batch, rays)
    whole, face_alone_image = maps.pictures(merged, face_map if face_image else None)
    eyes_alone_image = maps.eye_crop(eyes_map, turn=model.config.merge == "joint") if eyes_image else None
    return TrainingRender(whole, eyes_alone_image, window, face_alone_image, terms)


def _samples(
    model: TwoStreamField, batch: Batch, shell: float | None, samples: int, noise: float, jitter: bool
) -> RaySamples:
    """Samples (B, R, S) of the batch's rays; see `render_batch`."""
    if shell is None:
        found = slab_samples(batch.rays_o.reshape(-1, 3), batch.rays_d.reshape(-1, 3), model.config, jitter)
    else:
        centre = batch.distance.reshape(-1)
        if noise > 0:
            centre = centre + noise * torch.randn_like(centre)
        found = shell_samples(centre, shell, samples, jitter)
    shape = (*batch.rays.shape, -1)
    return RaySamples(found.t.reshape(shape), found.deltas.reshape(shape))


def _put(target: torch.Tensor, index: torch.Tensor, values: torch.Tensor) -> torch.Tensor:
    """target (B, N, C) with rows `index` (B, R) replaced by values (B, R, C), out of place."""
    return target.scatter(1, index.unsqueeze(-1).expand_as(values), values)


class _Maps:
    """Feature maps of a batch over the background, and their pictures.

    Attributes:
        size: Side of a feature map.
        label: (B, 2) gaze as the streams take it.
        background: (B, size * size, C).
    """

    def __init__(self, model: TwoStreamField, batch: Batch, operations: Operations) -> None:
        self.model, self.batch, self.size = model, batch, model.config.feature_size
        self.operations = operations
        self.label = model.label(batch.gaze)
        background = model.renderer.background(self.size, self.size).float()
        self.background = background.flatten(2).transpose(1, 2).expand(len(batch.rays), -1, -1)

    def turn(self, rows: torch.Tensor) -> torch.Tensor:
        """Features (B, ., C) turned by the gaze."""
        return self.model.move_eyes(rows, self.label[:, None, :])

    def whole(self, seen: Composited, index: torch.Tensor) -> torch.Tensor:
        """The background's map with what is seen put in at feature pixels `index` (B, R)."""
        return _put(self.background, index, seen.over(pick(self.background, index)))

    def picture(self, feature_map: torch.Tensor, height: int | None = None, width: int | None = None) -> torch.Tensor:
        """A feature map (B, h * w, C) drawn, (B, 3, H, W)."""
        height, width = height or self.size, width or self.size
        return self.operations.pictures(self.model.renderer, feature_map.unflatten(1, (height, width)))

    def pictures(self, merged: torch.Tensor, face: torch.Tensor | None) -> tuple[torch.Tensor, torch.Tensor | None]:
        """The merged map and, where given, the face's (B, size * size, C) drawn; their windows where there are some."""
        height = width = None
        if self.batch.window is not None:
            height, width = self.batch.window
            merged, face = self.cut(merged, height, width), None if face is None else self.cut(face, height, width)
        if face is None:
            return self.picture(merged, height, width), None
        if self.operations.together:
            both = self.picture(torch.cat([merged, face]), height, width)
            return both[: len(merged)], both[len(merged) :]
        return self.picture(merged, height, width), self.picture(face, height, width)

    def eye_crop(self, feature_map: torch.Tensor, turn: bool) -> torch.Tensor:
        """The picture of the crop around the eyes, or of the window, of a map (B, size * size, C); `turn` turns it by
        the gaze first."""
        height, width = self.batch.window or eye_crop(self.size)
        seen = self.cut(feature_map, height, width)
        return self.picture(self.turn(seen) if turn else seen, height, width)

    def cut(self, feature_map: torch.Tensor, height: int, width: int) -> torch.Tensor:
        """What lies in a map (B, size * size, C) in height x width from the batch's corners, (B, height * width, C)."""
        rows = self.batch.eye_corner[:, :1] + torch.arange(height, device=feature_map.device)
        columns = self.batch.eye_corner[:, 1:] + torch.arange(width, device=feature_map.device)
        return pick(feature_map, (rows[:, :, None] * self.size + columns[:, None, :]).reshape(len(feature_map), -1))
