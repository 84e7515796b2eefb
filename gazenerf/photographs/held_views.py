"""Views of a field whose geometry is held: what does not change while colours are learned is computed once.

Samples that hardly count are dropped. Of the others, what the trunk gives is kept in half precision; only feature
layers, planes of features and the neural renderer are computed again at each step.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch

from gazenerf.field.compositing import StreamSamples, composite_joint, composite_stream
from gazenerf.field.model import TwoStreamField
from gazenerf.field.plane import plane_coordinates
from gazenerf.field.sampling import shell_samples
from gazenerf.geometry import Camera, Gaze
from gazenerf.head_model.follow import codes_at
from gazenerf.heads import Head
from gazenerf.heads.feature_map import FeatureGrid
from gazenerf.subjects import Codes

LEAST_WEIGHT = 0.01
"""Share of a ray's light from which a sample is kept; the weights of those kept are raised to sum to the same."""

Window = tuple[int, int, int, int]
"""Top row, left column, height and width in feature pixels."""


@dataclass(frozen=True)
class HeldStream:
    """The samples of one stream that count.

    Attributes:
        ray: (K,) int64 flat index of the feature pixel.
        weight: (K,) share of that pixel's light.
        hidden: (K, H) float16 of the trunk.
        coordinates: (K, 2) float32 on the plane of features.
    """

    ray: torch.Tensor
    weight: torch.Tensor
    hidden: torch.Tensor
    coordinates: torch.Tensor

    def within(self, chosen: torch.Tensor, size: int) -> tuple[HeldStream, torch.Tensor]:
        """The samples whose feature pixel has a number of 0 or more in `chosen` (h * w,), under that number.

        Also their summed weights (size,).
        """
        number = chosen[self.ray]
        keep = (number >= 0).nonzero()[:, 0]
        part = HeldStream(number[keep], self.weight[keep], self.hidden[keep], self.coordinates[keep])
        return part, torch.zeros(size).index_add(0, part.ray, part.weight)


@dataclass(frozen=True)
class HeldView:
    """A view of a field whose densities do not change.

    Attributes:
        codes: Of the person.
        camera: Of the picture.
        gaze: Of the eyes.
        shape: (h, w) of the feature map.
        streams: By name.
        opacity: (h, w).
    """

    codes: Codes
    camera: Camera
    gaze: Gaze
    shape: tuple[int, int]
    streams: dict[str, HeldStream]
    opacity: torch.Tensor


def hold_view(head: Head, camera: Camera, gaze: Gaze) -> HeldView:
    """Compute a view's geometry, on the CPU.

    Args:
        head: A field of two streams that are composited as one medium.
        camera: Of a picture whose size is a multiple of a feature pixel.
        gaze: Of the eyes.
    """
    bound, config = head.at(gaze), head.field.config
    grid = FeatureGrid.of(camera, config)
    names = tuple(head.field.streams)
    with head.quickly():
        distance, hit = bound.surface(grid.rays_o, grid.rays_d, names)
        rays = hit.nonzero()[:, 0]
        t, deltas = shell_samples(distance[rays], config.shell, config.shell_samples)
        points = grid.rays_o[rays, None] + t[..., None] * grid.rays_d[rays, None]
        near = bound.near_eyes(points).any(-1).nonzero()[:, 0]
        face = _queried(head, bound, "face", points)
        eyes = _queried(head, bound, "eyes", points[near])
        weights = {"face": composite_stream(StreamSamples(face[0], face[0][..., None]), deltas).weights}
        weights["face"][near], eye_weights, _ = composite_joint(face[0][near], eyes[0], deltas[near])
        streams = {
            "face": _kept(rays, weights["face"], *face[1:]),
            "eyes": _kept(rays[near], eye_weights, *eyes[1:]),
        }
        opacity = torch.zeros(len(grid.rays_o)).index_add(0, rays, weights["face"].sum(-1))
        opacity = opacity.index_add(0, rays[near], eye_weights.sum(-1)).reshape(grid.shape)
    owned = {name: HeldStream(*(value.clone() for value in vars(stream).values())) for name, stream in streams.items()}
    return HeldView(head.subject.codes, camera, gaze, grid.shape, owned, opacity.clone())


def _queried(head: Head, bound, name: str, points: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Density (R, S), half precision trunk (R, S, H) and plane coordinates (R, S, 2) at points (R, S, 3)."""
    stream, found = head.field.stream(name), []
    for chunk in points.split(max(1, head.chunk // points.shape[1])):
        density, hidden, places = stream.trunk_of(chunk[None], bound.conditions[name])
        density = head.field.confine(name, density.reshape(chunk.shape[:2]), chunk)
        coordinates = plane_coordinates(places[0]).reshape(*chunk.shape[:2], 2)
        found.append((density, hidden[0].half().reshape(*chunk.shape[:2], hidden.shape[-1]), coordinates))
    density, hidden, coordinates = (torch.cat(parts) for parts in zip(*found, strict=True))
    return density, hidden, coordinates


def _kept(rays: torch.Tensor, weights: torch.Tensor, hidden: torch.Tensor, coordinates: torch.Tensor) -> HeldStream:
    keep = weights > LEAST_WEIGHT
    kept = torch.where(keep, weights, 0.0)
    kept = kept * (weights.sum(-1) / kept.sum(-1).clamp(min=1e-6))[:, None]
    ray = rays[:, None].expand_as(keep)
    return HeldStream(ray[keep], kept[keep], hidden[keep], coordinates[keep])


def draw_held(field: TwoStreamField, view: HeldView, window: Window | None = None) -> torch.Tensor:
    """A picture (3, height * k, width * k) of a window of a view, with gradients.

    Args:
        field: With the densities that the view was held with.
        view: See `hold_view`.
        window: All of the view by default.
    """
    top, left, height, width = window or (0, 0, *view.shape)
    chosen = torch.full(view.shape, -1)
    chosen[top : top + height, left : left + width] = torch.arange(height * width).reshape(height, width)
    shape_code = torch.from_numpy(codes_at(view.codes, view.gaze).shape_code)[None]
    appearance = torch.from_numpy(view.codes.appearance_code)[None]
    label = field.label(torch.from_numpy(view.gaze.label)[None])
    background = field.renderer.background(*view.shape)[0, :, top : top + height, left : left + width].flatten(1).T
    left_over = torch.ones(height * width)
    rows = torch.zeros_like(background)
    for name, held in view.streams.items():
        part, opacity = held.within(chosen.flatten(), height * width)
        stream, condition = field.stream(name), field.stream(name).condition(shape_code, appearance, label)
        feature = stream.hidden_feature(part.hidden.float()[None], condition, part.coordinates[None])[0]
        summed = feature.new_zeros(height * width, feature.shape[-1])
        summed = summed.index_add(0, part.ray, part.weight[:, None] * feature)
        found = stream.project(summed[None], opacity[None])[0]
        rows = rows + (found if name == "face" else field.move_eyes(found, label))
        left_over = left_over - opacity
    rows = rows + left_over[:, None] * background
    return field.renderer(rows.T.reshape(1, -1, height, width))[0]
