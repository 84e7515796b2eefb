"""The critic that encoder and decoder are trained against."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import nn


class Critic(nn.Module):
    """Tells patches of decoded pictures from true ones: (B, 3, S, S) to logits (B, 1, h, w), high for decoded."""

    def __init__(self, channels: int = 64) -> None:
        super().__init__()
        parts: list[nn.Module] = [nn.Conv2d(3, channels, 4, stride=2, padding=1), nn.LeakyReLU(0.2)]
        for factor, stride in ((2, 2), (4, 2), (8, 1)):
            before, after = factor // 2 * channels, factor * channels
            parts += [nn.Conv2d(before, after, 4, stride=stride, padding=1, bias=False), nn.BatchNorm2d(after)]
            parts.append(nn.LeakyReLU(0.2))
        self.layers = nn.Sequential(*parts, nn.Conv2d(8 * channels, 1, 4, padding=1))

    def forward(self, pictures: torch.Tensor) -> torch.Tensor:
        """See the class."""
        return self.layers(pictures)


def says(logits: torch.Tensor, decoded: bool) -> torch.Tensor:
    """Cross-entropy of the critic's logits with all patches decoded, or all true."""
    wanted = torch.ones_like(logits) if decoded else torch.zeros_like(logits)
    return F.binary_cross_entropy_with_logits(logits, wanted)
