"""The network: a dense encoder and decoder, and between them factors that are turned."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import torch
from torch import nn

from gazenerf.baselines.sted.config import StedConfig
from gazenerf.field.eye_motion import gaze_rotation

BOTTLENECK = 2
"""Side, pixels, of what lies between encoder and decoder."""

HEAD, GAZE = -2, -1
"""Which factors are the head's and the gaze's."""


@dataclass(frozen=True)
class Factors:
    """What the encoder says of B pictures.

    Attributes:
        appearance: (B, A).
        angles: One (B, 1) or (B, 2) a factor, radians; of two, pitch and yaw.
        embeddings: One (B, 2, W) or (B, 3, W) a factor.
    """

    appearance: torch.Tensor
    angles: list[torch.Tensor]
    embeddings: list[torch.Tensor]

    def turned(self, angles: list[torch.Tensor]) -> Factors:
        """The same with every embedding turned from its angles to others."""
        found = [
            rotation(to) @ rotation(now).transpose(1, 2) @ embedding
            for to, now, embedding in zip(angles, self.angles, self.embeddings, strict=True)
        ]
        return Factors(self.appearance, angles, found)

    def straight(self) -> Factors:
        """The same with every embedding turned to angles of zero."""
        return self.turned([torch.zeros_like(angle) for angle in self.angles])

    def towards(self, gaze: torch.Tensor, head: torch.Tensor) -> Factors:
        """The same with another gaze and head, (B, 2) each; all other factors stay."""
        angles = list(self.angles)
        angles[GAZE], angles[HEAD] = gaze, head
        return self.turned(angles)

    @property
    def flat(self) -> torch.Tensor:
        """(B, E) appearance and embeddings, as the decoder takes them."""
        return torch.cat([self.appearance, *(embedding.flatten(1) for embedding in self.embeddings)], dim=1)


def rotation(angles: torch.Tensor) -> torch.Tensor:
    """(B, 2, 2) of one angle (B, 1), or (B, 3, 3) = Ry(yaw) Rx(pitch) of two (B, 2)."""
    if angles.shape[-1] == 2:
        return gaze_rotation(angles)
    cos, sin = angles[:, 0].cos(), angles[:, 0].sin()
    return torch.stack([torch.stack([cos, -sin], dim=-1), torch.stack([sin, cos], dim=-1)], dim=-2)


def _composite(inputs: int, convolution: nn.Module) -> nn.Sequential:
    return nn.Sequential(nn.InstanceNorm2d(inputs), nn.LeakyReLU(), convolution)


def _up(inputs: int, outputs: int) -> nn.ConvTranspose2d:
    return nn.ConvTranspose2d(inputs, outputs, 3, stride=2, padding=1, output_padding=1, bias=False)


class DenseBlock(nn.Module):
    """Layers that each see all before them and add `growth` channels."""

    def __init__(self, inputs: int, config: StedConfig) -> None:
        super().__init__()
        self.layers = nn.ModuleList(
            _composite(channels, nn.Conv2d(channels, config.growth, 3, padding=1, bias=False))
            for channels in range(inputs, inputs + config.layers * config.growth, config.growth)
        )
        self.outputs = inputs + config.layers * config.growth

    def forward(self, maps: torch.Tensor) -> torch.Tensor:
        """(B, C, H, W) to (B, C + layers * growth, H, W)."""
        for layer in self.layers:
            maps = torch.cat([maps, layer(maps)], dim=1)
        return maps


class Encoder(nn.Module):
    """Pictures (B, 3, S, S) in [-1, 1] to `Factors`."""

    def __init__(self, config: StedConfig) -> None:
        super().__init__()
        self.config = config
        growth = config.growth
        parts: list[nn.Module] = [
            nn.Conv2d(3, 2 * growth, 3, stride=2, padding=1, bias=False),
            _composite(2 * growth, nn.Conv2d(2 * growth, 4 * growth, 3, stride=2, padding=1, bias=False)),
        ]
        channels = 4 * growth
        for number in range(config.blocks):
            parts.append(block := DenseBlock(channels, config))
            channels = block.outputs
            if number < config.blocks - 1:
                parts += [_composite(channels, nn.Conv2d(channels, channels, 1, bias=False)), nn.AvgPool2d(2)]
        self.maps = nn.Sequential(*parts)
        flat = channels * BOTTLENECK**2
        self.angles = nn.Sequential(nn.Linear(flat, 96), nn.LeakyReLU(), nn.Linear(96, sum(config.angles)))
        self.embeddings = nn.Sequential(nn.Linear(flat, flat), nn.LeakyReLU(), nn.Linear(flat, config.embedding))

    def forward(self, pictures: torch.Tensor) -> Factors:
        """See the class."""
        config = self.config
        flat = self.maps(pictures).flatten(1)
        angles = 0.5 * math.pi * torch.tanh(self.angles(flat))
        sizes = [(count + 1) * config.width for count in config.angles]
        appearance, *found = self.embeddings(flat).split([config.appearance, *sizes], dim=1)
        embeddings = [part.unflatten(1, (-1, config.width)) for part in found]
        return Factors(appearance, list(angles.split(list(config.angles), dim=1)), embeddings)


class Decoder(nn.Module):
    """What `Factors.flat` gives (B, E) to pictures (B, 3, S, S), about [-1, 1]."""

    def __init__(self, config: StedConfig) -> None:
        super().__init__()
        growth, channels = config.growth, max(1, config.embedding // BOTTLENECK**2)
        self.channels = channels
        self.entry = nn.Linear(config.embedding, channels * BOTTLENECK**2)
        parts: list[nn.Module] = []
        for number in range(config.blocks):
            parts.append(block := DenseBlock(channels, config))
            channels = block.outputs
            if number < config.blocks - 1:
                parts.append(_composite(channels, _up(channels, channels)))
        parts += [
            _up(channels, 4 * growth),
            _composite(4 * growth, _up(4 * growth, 2 * growth)),
            _composite(2 * growth, nn.Conv2d(2 * growth, 3, 3, padding=1, bias=False)),
        ]
        self.maps = nn.Sequential(*parts)

    def forward(self, flat: torch.Tensor) -> torch.Tensor:
        """See the class."""
        return self.maps(self.entry(flat).unflatten(1, (self.channels, BOTTLENECK, BOTTLENECK)))


class Sted(nn.Module):
    """Encoder and decoder.

    Attributes:
        config: Sizes.
        about: Provenance stored with the weights, JSON-able.
        weights_hash: `gazenerf.checkpoints.weights_hash` of the file they were read from, else empty.
    """

    def __init__(self, config: StedConfig) -> None:
        super().__init__()
        self.config, self.weights_hash = config, ""
        self.about: dict[str, Any] = {}
        self.encoder, self.decoder = Encoder(config), Decoder(config)
        if not self.decoder.entry.weight.is_meta:
            for module in self.modules():
                if isinstance(module, (nn.Conv2d, nn.ConvTranspose2d)):
                    nn.init.kaiming_normal_(module.weight)
            last = self.encoder.angles[-1]
            assert isinstance(last, nn.Linear)
            nn.init.zeros_(last.weight)
            nn.init.zeros_(last.bias)

    def decode(self, factors: Factors) -> torch.Tensor:
        """Pictures (B, 3, S, S), about [-1, 1]."""
        return self.decoder(factors.flat)

    def redirect(self, pictures: torch.Tensor, gaze: torch.Tensor, head: torch.Tensor) -> torch.Tensor:
        """Pictures of the same people and light with another gaze and head.

        Args:
            pictures: (B, 3, S, S) in [-1, 1].
            gaze: (B, 2) pitch up and yaw to the subject's left, radians, head frame.
            head: (B, 2) the same of the direction from the head to the camera.

        Returns:
            (B, 3, S, S), about [-1, 1].
        """
        return self.decode(self.encoder(pictures).towards(gaze, head))
