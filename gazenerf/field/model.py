"""The field: streams, the way their features meet, and the neural renderer."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import torch
from torch import nn

from gazenerf.field.compositing import StreamSamples, composite_stream, composite_streams
from gazenerf.field.config import FieldConfig
from gazenerf.field.detail import AROUND_EYES, SurfaceDetail, TextureDetail
from gazenerf.field.eye_motion import EYE_MOTIONS, EyeCentres, EyePose
from gazenerf.field.neural_renderer import NeuralRenderer
from gazenerf.field.streams import Stream, StreamCondition

FAR = 10.0
"""Distance, world units, that stands for any where a stream has no surface."""


class TwoStreamField(nn.Module):
    """GazeNeRF and its relatives: two streams or one, by configuration.

    Attributes:
        config: Sizes and conventions.
        streams: `face` and `eyes`, or `head` alone.
        renderer: Shared by all pictures.
        texture_detail: What texture codes say of the skin beyond the streams, in fields that have it; else None.
        lashes: How dark lashes make lids, as logarithms of the pictures' colour ratios; None of fields without them.
        detail: What is added to pictures of the face, in fields that were fine-tuned to one person; else None.
        eye_centres: Where the eyeballs turn, of fields whose eyes turn rigidly.
        about: Provenance stored with the weights, JSON-able.
        weights_hash: Names the weights; empty for a field that was never saved.
        untuned: The field that this one was fine-tuned from to one person, in a tuple; empty for all others.
    """

    def __init__(self, config: FieldConfig) -> None:
        super().__init__()
        self.config = config
        names = ("face", "eyes") if config.streams == "two" else ("head",)
        self.streams = nn.ModuleDict({name: Stream(config, name) for name in names})
        self.renderer = NeuralRenderer(config)
        self.eye_centres = EyeCentres(config.identity) if config.eye_motion == "rigid" else None
        self.texture_detail = TextureDetail(config) if any(config.detail) else None
        self.lashes = SurfaceDetail(torch.zeros(1, *config.lashes), AROUND_EYES) if any(config.lashes) else None
        self.detail: SurfaceDetail | None = None
        self.about: dict[str, Any] = {}
        self.weights_hash = ""
        self.untuned: tuple[TwoStreamField, ...] = ()  # a module in an attribute of its own would be a part of this one

    def stream(self, name: str) -> Stream:
        """A stream by name."""
        stream = self.streams[name]
        assert isinstance(stream, Stream)
        return stream

    def label(self, gaze: torch.Tensor) -> torch.Tensor:
        """Native gaze (..., 2) = (pitch up, yaw left) to what the streams' label means."""
        return gaze * _filled(self.config.gaze_label_signs, gaze)

    def move_eyes(self, features: torch.Tensor, label: torch.Tensor) -> torch.Tensor:
        """Features (..., C) turned by the configured eye motion; label (..., 2) broadcasts."""
        return EYE_MOTIONS[self.config.eye_motion](features, label)

    def eye_pose(self, name: str, shape_code: torch.Tensor, label: torch.Tensor) -> EyePose | None:
        """How a stream's points turn with shape codes (B, .) at labels (B, 2); None where they do not."""
        if self.eye_centres is None or name != "eyes":
            return None
        return self.eye_centres.pose(shape_code[:, : self.config.identity], self.label(label))  # signs undo themselves

    def condition(
        self, name: str, shape_code: torch.Tensor, appearance_code: torch.Tensor, label: torch.Tensor
    ) -> StreamCondition:
        """Codes (B, .) and label (B, 2) folded into a stream by name, with the pose of rigid eyes."""
        found = self.stream(name).condition(shape_code, appearance_code, label)
        return replace(found, pose=self.eye_pose(name, shape_code, label))

    def signed_distance(self, name: str, points: torch.Tensor, condition: StreamCondition) -> torch.Tensor:
        """`Stream.signed_distance` of a stream by name; `FAR` where that stream was never trained."""
        found = self.stream(name).signed_distance(points, condition)
        within = self.confine(name, torch.ones_like(found), points) > 0.0
        return torch.where(within, found, FAR)

    def confine(self, name: str, density: torch.Tensor, points: torch.Tensor) -> torch.Tensor:
        """Density (...) of a stream at points (..., 3), 0 where that stream was never trained."""
        box = self.config.eyes_box
        if name != "eyes" or box is None:
            return density
        low, high = _filled(box[:3], points), _filled(box[3:], points)
        return density * ((points >= low) & (points <= high)).all(-1)

    def query(
        self, name: str, points: torch.Tensor, condition: StreamCondition, features: bool = True
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """`Stream.query` of a stream by name, its density confined to where it was trained."""
        density, hidden = self.stream(name).query(points, condition, features)
        return self.confine(name, density, points), hidden

    def samples(
        self, name: str, points: torch.Tensor, condition: StreamCondition, batched: bool = True
    ) -> StreamSamples:
        """`query` of a stream by name as samples of rays, to be composited.

        Args:
            points: (B, R, S, 3), or (R, S, 3) of one image where not `batched`.
            condition: Of the same B, or of one image.
        """
        density, hidden = self.query(name, points if batched else points[None], condition)
        if batched:
            return StreamSamples(density, hidden, self.stream(name).project)
        return StreamSamples(density[0], hidden[0].float(), self.stream(name).project)

    @property
    def template_jaw(self) -> float:
        """How far the mouth is open, 0 to 1, on the template that distances were learned with."""
        return float(self.about.get("geometry", {}).get("jaw", 0.0))

    @property
    def version(self) -> int:
        """Changes whenever a weight does; what is derived from weights is kept under it."""
        return hash(tuple((value.data_ptr(), value._version) for value in (*self.parameters(), *self.buffers())))

    def published_forward(
        self,
        shape_code: torch.Tensor,
        appearance_code: torch.Tensor,
        gaze_label: torch.Tensor,
        rotation: torch.Tensor,
        position: torch.Tensor,
        inv_intrinsics: torch.Tensor,
    ) -> dict[str, torch.Tensor]:
        """The published forward pass, line by line, slow.

        Args:
            shape_code, appearance_code, gaze_label: (B, .) as the network takes them.
            rotation: (B, 3, 3) world from camera; position: (B, 3, 1) world units.
            inv_intrinsics: (B, 3, 3) at feature-map resolution, for ray coordinates index + ray_offset.

        Returns:
            `image`, `image_background` and per stream `image_*` (B, 3, H, W), `background_alpha_*`,
            `depth_*` (B, 1, S * S; the weighted sum of z displacement from the camera, not divided
            by opacity), `density_*` (B, 1, rays, samples), `points` (B, 3, rays, samples). A joint
            merge composites both densities as one medium.
        """
        config, size, batch = self.config, self.config.feature_size, shape_code.shape[0]
        device = rotation.device
        index = torch.arange(size, dtype=torch.float32, device=device) + config.ray_offset
        rows, columns = torch.meshgrid(index, index, indexing="ij")
        pixels = torch.stack([columns, rows, torch.ones_like(rows)]).reshape(1, 3, -1)
        directions = rotation @ (inv_intrinsics @ pixels)
        directions = directions / directions.norm(dim=1, keepdim=True)
        stretch = 1.0 / directions[:, 2:].abs()  # ray length per unit of z
        share = torch.linspace(0.0, 1.0, config.samples + 1, device=device)
        height = position[:, 2]
        displacement = ((height - config.z_near) * (1.0 - share) + (height - config.z_far) * share)[:, None]
        deltas = (displacement[..., 1:] - displacement[..., :-1]) * stretch.transpose(1, 2)
        # The order of these operations is the published one: at 512 waves a unit rounding shows.
        points = position[..., None] + (directions * stretch)[..., None] * displacement[:, None, :, :-1]
        samples = points.permute(0, 2, 3, 1)
        background = self.renderer.background(size, size)
        flat = background.flatten(2).transpose(1, 2)
        out: dict[str, torch.Tensor] = {"points": points, "image_background": self.renderer(background)}
        maps: dict[str, torch.Tensor] = {}
        seen: dict[str, StreamSamples] = {}
        for name in self.streams:
            pose = self.eye_pose(name, shape_code, gaze_label)
            still = samples if pose is None else pose.straight_ahead(samples)
            density, features = self.stream(name)(still, shape_code, appearance_code, gaze_label)
            seen[name] = StreamSamples(self.confine(name, density, samples), features)
            found = composite_stream(seen[name], deltas)
            rows = found.over(flat)
            maps[name] = rows if name == "face" else self.move_eyes(rows, gaze_label[:, None])
            out[f"background_alpha_{name}"] = (1.0 - found.opacity)[:, None]
            out[f"depth_{name}"] = (found.weights * displacement[..., :-1]).sum(-1)[:, None]
            out[f"density_{name}"] = seen[name].density[:, None]
        if "head" in maps:
            merged = maps["head"]
        elif config.merge == "max":
            merged = torch.maximum(maps["face"], maps["eyes"])
        else:
            turn = partial(self.move_eyes, label=gaze_label[:, None])
            merged = composite_streams(seen["face"], seen["eyes"], deltas, turn).over(flat)

        def picture(rows: torch.Tensor) -> torch.Tensor:
            return self.renderer(rows.transpose(1, 2).reshape(batch, -1, size, size))

        out["image"] = picture(merged)
        for name in maps:
            if name != "head":
                out[f"image_{name}"] = picture(maps[name])
        return out


def _filled(values: tuple[float, ...], like: torch.Tensor) -> torch.Tensor:
    """(n,) of constants made where `like` lives: copied from the host, each would make a GPU wait."""
    return torch.cat([like.new_full((1,), value) for value in values])
