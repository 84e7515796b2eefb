"""The operations that a training step spends its time in: as the field defines them, and fused for a GPU.

`REFERENCE` computes a picture as `gazenerf.field.neural_renderer` does and each picture's loss alone.
`FUSED` computes the same with fewer passes over full-size tensors; tests hold it to the reference.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import torch
import torch.nn.functional as F
from torch import nn

from gazenerf.field.neural_renderer import SLOPE, NeuralRenderer, Upsample, narrowed_repeat, sub_pixels_first
from gazenerf.training.losses import perceptual_loss, reconstruction_loss

FeatureMaps = Callable[[torch.Tensor], Sequence[torch.Tensor]]
"""Pictures (B, 3, H, W) to the feature maps of a frozen network."""


@dataclass(frozen=True)
class Operations:
    """How the heavy parts of a training step are computed.

    Attributes:
        pictures: A neural renderer and feature maps (B, h, w, C) to pictures (B, 3, H, W) float32 in (0, 1).
        reconstruction: A picture, its target (B, 3, H, W), masks (B, 1, H, W) and one of `losses.PIXEL_ERRORS` to the
            loss of paper Eq. 5 in each mask.
        perceptual: Feature maps of a network, pictures and targets (B, 3, H, W) to the loss of paper Eq. 7.
        together: Pictures of one size go through `pictures` and `perceptual` in one pass.
    """

    pictures: Callable[[NeuralRenderer, torch.Tensor], torch.Tensor]
    reconstruction: Callable[[torch.Tensor, torch.Tensor, Sequence[torch.Tensor], str], list[torch.Tensor]]
    perceptual: Callable[[FeatureMaps, torch.Tensor, torch.Tensor], torch.Tensor]
    together: bool


def reference_pictures(renderer: NeuralRenderer, maps: torch.Tensor) -> torch.Tensor:
    """Feature maps (B, h, w, C) drawn by the renderer itself."""
    return renderer(maps.permute(0, 3, 1, 2)).float()


def fused_pictures(renderer: NeuralRenderer, maps: torch.Tensor) -> torch.Tensor:
    """Feature maps (B, h, w, C) drawn with the channels last throughout; see `_doubled`."""
    if torch.is_autocast_enabled(maps.device.type):
        maps = maps.to(torch.get_autocast_dtype(maps.device.type))
    layers = [layer for layer in renderer.to_rgb if isinstance(layer, nn.Conv2d)]
    rgb = _linear(layers[0], maps)
    for upsample, narrow, to_rgb in zip(renderer.upsample, renderer.narrow, layers[1:], strict=True):
        assert isinstance(upsample, Upsample) and isinstance(narrow, nn.Conv2d)
        maps = _doubled(upsample, narrow, maps)
        larger = F.interpolate(rgb.permute(0, 3, 1, 2), scale_factor=2, mode="bilinear", align_corners=False)
        rgb = _blurred(larger.permute(0, 2, 3, 1)) + _linear(to_rgb, maps)
    return torch.sigmoid(rgb.permute(0, 3, 1, 2).float()).contiguous()


def _linear(layer: nn.Conv2d, maps: torch.Tensor) -> torch.Tensor:
    """A 1x1 convolution of maps (B, h, w, C)."""
    return F.linear(maps, layer.weight[:, :, 0, 0], layer.bias)


def _doubled(upsample: Upsample, narrow: nn.Conv2d, maps: torch.Tensor) -> torch.Tensor:
    """`leaky_relu(narrow(upsample(maps)))` of maps (B, h, w, C), as (B, 2h, 2w, N).

    Blur and pixel shuffle treat every channel alike, so the narrowing layer commutes with both and runs
    first: they then move N channels instead of C; see `narrowed_repeat` for what the residual adds.
    """
    batch, height, width, channels = maps.shape
    flat = maps.reshape(-1, channels)
    first, second = upsample.widen_0, upsample.widen_1
    assert first.bias is not None and second.bias is not None
    narrowing = narrow.weight[:, :, 0, 0]
    wide_weight, wide_bias = sub_pixels_first(second.weight[:, :, 0, 0]), sub_pixels_first(second.bias)
    wide = F.leaky_relu(F.linear(flat, first.weight[:, :, 0, 0], first.bias), SLOPE)
    wide = F.leaky_relu(F.linear(wide, wide_weight, wide_bias), SLOPE)
    narrowed = F.linear(wide.reshape(-1, channels), narrowing, narrow.bias).reshape(len(flat), -1)
    kept = narrowed + F.linear(flat, narrowed_repeat(narrowing))
    shuffled = kept.reshape(batch, height, width, 2, 2, -1).permute(0, 1, 3, 2, 4, 5)
    return F.leaky_relu(_blurred(shuffled.reshape(batch, 2 * height, 2 * width, -1)), SLOPE)


def _blurred(maps: torch.Tensor) -> torch.Tensor:
    """[1 2 1] / 4 along both sides of maps (B, H, W, C), with reflected borders."""
    rows = torch.cat([maps[:, 1:2], maps, maps[:, -2:-1]], dim=1)
    maps = 0.25 * (rows[:, :-2] + rows[:, 2:]) + 0.5 * maps
    columns = torch.cat([maps[:, :, 1:2], maps, maps[:, :, -2:-1]], dim=2)
    return 0.25 * (columns[:, :, :-2] + columns[:, :, 2:]) + 0.5 * maps


def reconstruction_losses(
    image: torch.Tensor, target: torch.Tensor, masks: Sequence[torch.Tensor], error: str = "l1"
) -> list[torch.Tensor]:
    """`reconstruction_loss` in several masks; only a compiler makes one pass of it."""
    return [reconstruction_loss(image, target, mask, error) for mask in masks]


def fused_perceptual(features: FeatureMaps, images: torch.Tensor, targets: torch.Tensor) -> torch.Tensor:
    """`perceptual_loss` whose differences stay in the precision of the maps; their means are float32."""
    with torch.no_grad():
        wanted = features(targets)
    got = features(images)
    terms = [(a - b).abs().mean(dtype=torch.float32) for a, b in zip(got, wanted, strict=True)]
    return torch.stack(terms).sum()


REFERENCE = Operations(reference_pictures, reconstruction_losses, perceptual_loss, together=False)
"""Each picture alone, by the field's own modules."""

FUSED = Operations(fused_pictures, reconstruction_losses, fused_perceptual, together=True)
"""The same numbers up to rounding, in fewer passes."""


def compiled(operations: Operations, **how: Any) -> Operations:
    """Operations whose square pictures go through `torch.compile`, one program for any number of them.

    The crops around the eyes are a tenth of the pixels and run as they are: a second shape would cost
    as long to compile as the whole pictures do.

    Args:
        operations: What is compiled, at its first use.
        how: Given to `torch.compile`.
    """
    pictures = torch.compile(operations.pictures, **how)
    reconstruction = torch.compile(operations.reconstruction, **how)
    perceptual = torch.compile(operations.perceptual, **how)

    def draw(renderer: NeuralRenderer, maps: torch.Tensor) -> torch.Tensor:
        chosen = pictures if _square(maps.shape[1:3], maps) else operations.pictures
        return chosen(renderer, maps)

    def differ(
        image: torch.Tensor, target: torch.Tensor, masks: Sequence[torch.Tensor], error: str = "l1"
    ) -> list[torch.Tensor]:
        chosen = reconstruction if _square(image.shape[2:], image, target, *masks) else operations.reconstruction
        return chosen(image, target, masks, error)

    def compare(features: FeatureMaps, images: torch.Tensor, targets: torch.Tensor) -> torch.Tensor:
        chosen = perceptual if _square(images.shape[2:], images, targets) else operations.perceptual
        return chosen(features, images, targets)

    return Operations(draw, differ, compare, operations.together)


def _square(sides: torch.Size, *batches: torch.Tensor) -> bool:
    """Whether both sides are alike; the number of pictures in the batches is then left open to the compiler."""
    if sides[0] != sides[1]:
        return False
    for batch in batches:
        torch._dynamo.maybe_mark_dynamic(batch, 0)  # pyright: ignore[reportPrivateImportUsage]
    return True
