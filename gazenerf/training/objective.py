"""The whole objective of one step: the paper's four losses and this project's geometry terms."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import torch
from torch import nn

from gazenerf.field.model import TwoStreamField
from gazenerf.training.batches import Batch
from gazenerf.training.config import TrainConfig
from gazenerf.training.forward import TrainingRender, render_batch
from gazenerf.training.losses import (
    disentanglement_loss,
    functional_weight,
    gaze_loss,
    reconstruction_loss,
)
from gazenerf.training.operations import REFERENCE, FeatureMaps, Operations
from gazenerf.training.windows import MARGIN


class Offsets(nn.Module):
    """Learned per-picture offsets to codes and cameras, zero at the start (paper Sec. 3.2).

    Attributes:
        codes: One table for each of identity, expression, texture, illumination.
        angles, shift: Camera corrections: Euler angles in radians about the camera's axes and a
            translation in world units.
    """

    def __init__(self, pictures: int, code_sizes: tuple[int, int, int, int]) -> None:
        super().__init__()
        self.codes = nn.ParameterList([nn.Parameter(torch.zeros(pictures, size)) for size in code_sizes])
        self.angles = nn.Parameter(torch.zeros(pictures, 3))
        self.shift = nn.Parameter(torch.zeros(pictures, 3))

    def move_rays(self, batch: Batch) -> Batch:
        """The batch seen from the corrected cameras."""
        angles, shift = self.angles[batch.index], self.shift[batch.index]
        skew = torch.zeros(len(angles), 3, 3, device=angles.device)
        skew[:, 0, 1], skew[:, 0, 2], skew[:, 1, 2] = -angles[:, 2], angles[:, 1], -angles[:, 0]
        skew = skew - skew.transpose(1, 2)
        rotation = torch.matrix_exp(skew)
        return replace(
            batch,
            rays_o=batch.rays_o + shift[:, None],
            rays_d=batch.rays_d @ rotation.transpose(1, 2),
        )


WARMUP_SHARE = 0.05
"""A run shaped by time has warmed up after this share of it, however few steps that were."""


def schedule(config: TrainConfig, step: int, share: float | None = None) -> float:
    """Learning rate at a step: linear warm-up, then a cosine to the final rate.

    Args:
        config: Rates, steps, warm-up.
        step: From zero.
        share: Of the run's time that is spent, 0 to 1, where time shapes the run instead of `config.steps`.
    """
    low, high = config.final_learning_rate, config.learning_rate
    if share is None:
        if step < config.warmup:
            return high * (step + 1) / config.warmup
        share = min(1.0, (step - config.warmup) / max(1, config.steps - config.warmup))
        return low + 0.5 * (high - low) * (1.0 + math.cos(math.pi * share))
    warm = min(1.0, max((step + 1) / max(1, config.warmup), share / WARMUP_SHARE))
    return warm * (low + 0.5 * (high - low) * (1.0 + math.cos(math.pi * min(1.0, share))))


class Objective(nn.Module):
    """Everything that is optimised, and the loss of a batch as its forward pass.

    Args:
        model: The field.
        config: Weights and sampling.
        pictures: How many captures there are, for the tables of offsets.
        features: Pictures (B, 3, H, W) to a list of feature maps, for the perceptual loss.
        estimate_gaze: Pictures (B, 3, H, W) to gaze (B, 2), for the functional loss.

    Attributes:
        operations: How pictures and the perceptual loss are computed; may be changed between steps.
    """

    def __init__(
        self,
        model: TwoStreamField,
        config: TrainConfig,
        pictures: int,
        features: FeatureMaps | None = None,
        estimate_gaze: Callable[[torch.Tensor], torch.Tensor] | None = None,
        operations: Operations = REFERENCE,
    ) -> None:
        super().__init__()
        self.model = model
        self.config = config
        self.operations = operations
        field = model.config
        self.offsets = (
            Offsets(pictures, (field.identity, field.expression, field.texture, field.illumination))
            if config.learn_codes or config.learn_cameras
            else None
        )
        if self.offsets is not None:  # what no loss reaches would keep several processes waiting
            self.offsets.codes.requires_grad_(config.learn_codes)
            self.offsets.angles.requires_grad_(config.learn_cameras)
            self.offsets.shift.requires_grad_(config.learn_cameras)
        self._frozen = (features, estimate_gaze)

    def forward(
        self, batch: Batch, step: int, epoch: int = 0, share: float | None = None
    ) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
        """Loss and its named parts, each weighted as it enters the sum.

        Args:
            batch: On the field's device.
            step: Steps done before this one.
            epoch: Times that every capture was shown.
            share: Of the run that is done, 0 to 1; `step` over all steps by default.
        """
        config = self.config
        moved = batch
        parts: dict[str, torch.Tensor] = {}
        if self.offsets is not None:
            if config.learn_cameras:
                moved = self.offsets.move_rays(moved)
            if config.learn_codes:
                deltas = [table[batch.index] for table in self.offsets.codes]
                moved = replace(
                    moved,
                    shape_code=batch.shape_code + torch.cat(deltas[:2], dim=1),
                    appearance_code=batch.appearance_code + torch.cat(deltas[2:], dim=1),
                )
                zeros = [torch.zeros_like(delta) for delta in deltas]
                parts["disentanglement"] = config.disentanglement * disentanglement_loss(
                    deltas, zeros, config.code_weights
                )
        progress = step / max(1, config.steps) if share is None else share
        terms = (config.depth, config.surface, config.opacity, config.empty, config.eyeball)
        geometry = any(terms) and self.model.config.geometry == "density"  # distances are held
        render = render_batch(
            self.model,
            moved,
            shell=config.shell,
            samples=config.shell_samples,
            noise=config.shell_noise,
            face_image=step % config.streams_every == 0,
            geometry=geometry,
            operations=self.operations,
        )
        parts |= self._pictures(render, batch, progress, epoch)
        if geometry:
            fade = 1.0 - (1.0 - config.geometry_decay) * progress
            weights = {
                "depth": config.depth,
                "surface": config.surface,
                "opacity": config.opacity,
                "empty": config.empty,
                "eyeball": config.eyeball,
            }
            parts |= {name: fade * weights[name] * term for name, term in render.terms.items()}
        return torch.stack(list(parts.values())).sum(), parts

    def _pictures(self, render: TrainingRender, batch: Batch, progress: float, epoch: int) -> dict[str, torch.Tensor]:
        config = self.config
        counts = self._counts(batch)
        head = (batch.parts > 0)[:, None] & counts
        eyes = (batch.parts >= 2)[:, None] & counts
        face = (batch.parts == 1)[:, None] & counts
        wanted = {"whole": (config.reconstruction, head)}
        if config.background_weight:
            wanted["background"] = (config.background_weight, (batch.parts == 0)[:, None] & counts)
        if config.eyes_weight:
            wanted["eyes_merged"] = (config.eyes_weight, eyes)
        masks_of = [mask for _, mask in wanted.values()]
        found = self.operations.reconstruction(render.image, batch.image, masks_of, config.pixel_error)
        parts = {name: weight * loss for (name, (weight, _)), loss in zip(wanted.items(), found, strict=True)}
        if render.face_image is not None:
            found_face = reconstruction_loss(render.face_image, batch.image, face, config.pixel_error)
            parts["face"] = config.reconstruction * found_face
        target = masks = None
        if render.eyes_image is not None:
            target, masks = _crop(batch.image, render), _crop(eyes.float(), render) > 0.5
            found_eyes = reconstruction_loss(render.eyes_image, target, masks, config.pixel_error)
            parts["eyes"] = config.reconstruction * found_eyes
        features, estimate_gaze = self._frozen
        if config.perceptual and features is not None and progress >= config.perceptual_start:
            pairs = [(render.image, head, batch.image)]
            if render.face_image is not None:
                pairs.append((render.face_image, face, batch.image))
            if render.eyes_image is not None and target is not None and masks is not None:
                pairs.append((render.eyes_image, masks, target))
            parts["perceptual"] = config.perceptual * self._perceptual(features, pairs)
        if config.functional and estimate_gaze is not None:
            weight = config.functional * functional_weight(epoch, config.functional_content)
            parts["functional"] = weight * gaze_loss(estimate_gaze, render.image * head, batch.image * head)
        return parts

    def _counts(self, batch: Batch) -> torch.Tensor:
        """(H, W) bool: all of a picture, and of a window what the neural renderer's blurs bring nothing into from
        beyond its edges."""
        counts = torch.ones(batch.parts.shape[-2:], dtype=torch.bool, device=batch.parts.device)
        if batch.window is None:
            return counts
        margin = MARGIN * (self.model.config.image_size // self.model.config.feature_size)
        inner = torch.zeros_like(counts)
        inner[margin:-margin, margin:-margin] = True
        return inner

    def _perceptual(
        self, features: FeatureMaps, pairs: list[tuple[torch.Tensor, torch.Tensor, torch.Tensor]]
    ) -> torch.Tensor:
        """The sum of the losses of (picture, mask, target); where they go together, those of one size in one pass."""
        compare = self.operations.perceptual
        if not self.operations.together:
            losses = [compare(features, image * mask, wanted * mask) for image, mask, wanted in pairs]
            return torch.stack(losses).sum()
        sizes: dict[tuple[int, ...], list[tuple[torch.Tensor, torch.Tensor]]] = {}
        for image, mask, wanted in pairs:
            sizes.setdefault(tuple(image.shape), []).append((image * mask, wanted * mask))
        return torch.stack(
            [
                len(group) * compare(features, torch.cat([p for p, _ in group]), torch.cat([t for _, t in group]))
                for group in sizes.values()
            ]
        ).sum()


def _crop(images: torch.Tensor, render: TrainingRender) -> torch.Tensor:
    """images (B, C, H, W) cut at each picture's eye window, whose place no host needs to know."""
    assert render.eyes_image is not None
    height, width = render.eyes_image.shape[-2:]
    rows = render.eyes_window[:, :1] + torch.arange(height, device=images.device)
    columns = render.eyes_window[:, 1:] + torch.arange(width, device=images.device)
    picture = torch.arange(len(images), device=images.device)
    found = images.permute(0, 2, 3, 1)[picture[:, None, None], rows[:, :, None], columns[:, None, :]]
    return found.permute(0, 3, 1, 2)


__all__ = ["Objective", "Offsets", "schedule"]
