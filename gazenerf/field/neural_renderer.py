"""The 2D neural renderer: feature map to picture (paper Sec. 3.2, "Rendering images")."""

from __future__ import annotations

from itertools import pairwise

import torch
import torch.nn.functional as F
from torch import nn

from gazenerf.field.config import FieldConfig

MIN_CHANNELS = 32
SLOPE = 0.2


def blur_kernel(channels: int, device: torch.device | None = None) -> torch.Tensor:
    """(C, 1, 3, 3) normalised [1 2 1] x [1 2 1] for each channel."""
    taps = torch.tensor([0.25, 0.5, 0.25], device=device)
    return (taps[:, None] * taps[None, :]).expand(channels, 1, 3, 3)


def blur(images: torch.Tensor, channels: int) -> torch.Tensor:
    """`blur_kernel` with reflected borders, (B, C, H, W); C is given as a number so that tracing knows it."""
    kernel = blur_kernel(channels, images.device).to(images)
    rows = torch.cat([images[:, :, 1:2], images, images[:, :, -2:-1]], dim=2)
    padded = torch.cat([rows[:, :, :, 1:2], rows, rows[:, :, :, -2:-1]], dim=3)
    return F.conv2d(padded, kernel, groups=channels)


def sub_pixels_first(outputs: torch.Tensor) -> torch.Tensor:
    """Weights or biases (4 C, ...) of `Upsample.widen_1` in the order s C + c of sub-pixel s and channel c.

    Its own order is 4 c + s; in this one the pixel shuffle is a permutation of rows.
    """
    return outputs.unflatten(0, (-1, 4)).transpose(0, 1).flatten(0, 1)


def narrowed_repeat(narrowing: torch.Tensor) -> torch.Tensor:
    """(4 N, C): what `Upsample`'s repeated input adds at each sub-pixel after a narrowing layer (N, C).

    Channel c of sub-pixel s is channel (4 c + s) mod C of the input, so one product of the input does what repeating
    it would.
    """
    narrow, channels = narrowing.shape
    index = torch.arange(channels, device=narrowing.device)
    sub_pixel = torch.arange(4, device=narrowing.device)
    source = (4 * index[None, :] + sub_pixel[:, None]) % channels
    chosen = (source[:, :, None] == index).to(narrowing.dtype)
    with torch.autocast(narrowing.device.type, enabled=False):
        return (narrowing @ chosen).reshape(4 * narrow, channels)


def levelled(background: torch.Tensor) -> torch.Tensor:
    """Background features (1, C, H, W) that are everywhere what they are along the upper edge, on average.

    Where heads always hide the background, training never says what it is, and it is a ghost that cameras further
    away than the captures' see around the head. For captures before one colour.
    """
    return background[..., :1, :].mean(-1, keepdim=True).expand_as(background).clone()


class Upsample(nn.Module):
    """Doubles a feature map by pixel shuffle, keeping its channels."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.channels = channels
        self.widen_0 = nn.Conv2d(channels, 2 * channels, 1)
        self.widen_1 = nn.Conv2d(2 * channels, 4 * channels, 1)

    def forward(self, features: torch.Tensor) -> torch.Tensor:
        """(B, C, H, W) to (B, C, 2H, 2W)."""
        wide = F.leaky_relu(self.widen_0(features), SLOPE)
        wide = F.leaky_relu(self.widen_1(wide), SLOPE) + features.repeat(1, 4, 1, 1)
        return blur(F.pixel_shuffle(wide, 2), self.channels)


class NeuralRenderer(nn.Module):
    """Up-samples a feature map of any size to a picture, all by 1x1 convolutions.

    Args:
        config: Feature channels, sizes, background.
    """

    def __init__(self, config: FieldConfig) -> None:
        super().__init__()
        blocks = config.upsampling.bit_length() - 1
        widths = [config.feature_channels]
        for _ in range(blocks):
            widths.append(max(MIN_CHANNELS, widths[-1] // 2))
        self.upsample = nn.ModuleList(Upsample(width) for width in widths[:-1])
        self.narrow = nn.ModuleList(nn.Conv2d(a, b, 1) for a, b in pairwise(widths))
        self.to_rgb = nn.ModuleList(nn.Conv2d(width, 3, 1) for width in widths)
        if config.initialisation == "he" and not self.to_rgb[0].weight.is_meta:
            for module in self.modules():
                if isinstance(module, nn.Conv2d):
                    nn.init.kaiming_normal_(module.weight, a=SLOPE)
                    assert module.bias is not None
                    nn.init.zeros_(module.bias)
        fill = torch.ones if config.background == "ones" else torch.zeros
        size = config.feature_size
        self.background_features = nn.Parameter(fill(1, config.feature_channels, size, size))

    def background(self, height: int, width: int) -> torch.Tensor:
        """(1, C, height, width) the learned feature of empty rays, interpolated to a size."""
        if self.background_features.shape[-2:] == (height, width):
            return self.background_features
        return F.interpolate(self.background_features, size=(height, width), mode="bilinear", align_corners=False)

    def forward(self, features: torch.Tensor) -> torch.Tensor:
        """Feature map (B, C, h, w) to sRGB pictures (B, 3, h * k, w * k) in (0, 1)."""
        features = features.contiguous(memory_format=torch.channels_last)
        rgb = self.to_rgb[0](features)
        for upsample, narrow, to_rgb in zip(self.upsample, self.narrow, list(self.to_rgb)[1:], strict=True):
            features = F.leaky_relu(narrow(upsample(features)), SLOPE)
            rgb = blur(F.interpolate(rgb, scale_factor=2, mode="bilinear", align_corners=False), 3) + to_rgb(features)
        return torch.sigmoid(rgb.float())
