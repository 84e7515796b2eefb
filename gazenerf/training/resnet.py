"""ResNet (He et al. 2016) without its classifier, under torchvision's names, so that weights of others load.

torchvision and timm have it, but timm needs torchvision, which this project does not.
"""

from __future__ import annotations

import torch
from torch import nn

RESNET50 = (3, 4, 6, 3)
"""Blocks in each of the four stages."""

EXPANSION, FEATURES = 4, 2048


class Bottleneck(nn.Module):
    """Three convolutions around which the input goes by; the second one strides.

    Args:
        inputs: Channels.
        width: Channels inside; four times as many come out.
        stride: Of the block.
    """

    def __init__(self, inputs: int, width: int, stride: int = 1) -> None:
        super().__init__()
        self.conv1, self.bn1 = nn.Conv2d(inputs, width, 1, bias=False), nn.BatchNorm2d(width)
        self.conv2, self.bn2 = nn.Conv2d(width, width, 3, stride, 1, bias=False), nn.BatchNorm2d(width)
        outputs = EXPANSION * width
        self.conv3, self.bn3 = nn.Conv2d(width, outputs, 1, bias=False), nn.BatchNorm2d(outputs)
        self.relu = nn.ReLU(inplace=True)
        self.downsample: nn.Sequential | None = None
        if stride != 1 or inputs != outputs:
            self.downsample = nn.Sequential(nn.Conv2d(inputs, outputs, 1, stride, bias=False), nn.BatchNorm2d(outputs))

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """(B, 4 width, H', W') of maps (B, inputs, H, W)."""
        around = x if self.downsample is None else self.downsample(x)
        x = self.relu(self.bn1(self.conv1(x)))
        x = self.relu(self.bn2(self.conv2(x)))
        return self.relu(self.bn3(self.conv3(x)) + around)


class ResNet(nn.Module):
    """Pictures (B, 3, H, W), standardised as ImageNet's, to features (B, 2048).

    Args:
        blocks: In each stage.
    """

    def __init__(self, blocks: tuple[int, int, int, int] = RESNET50) -> None:
        super().__init__()
        self.conv1, self.bn1 = nn.Conv2d(3, 64, 7, 2, 3, bias=False), nn.BatchNorm2d(64)
        self.relu, self.maxpool = nn.ReLU(inplace=True), nn.MaxPool2d(3, 2, 1)
        stages, inputs = [], 64
        for number, count in enumerate(blocks):
            width = 64 * 2**number
            layers = [Bottleneck(inputs, width, 1 if number == 0 else 2)]
            inputs = EXPANSION * width
            stages.append(nn.Sequential(*layers, *(Bottleneck(inputs, width) for _ in range(count - 1))))
        self.layer1, self.layer2, self.layer3, self.layer4 = stages
        self.avgpool = nn.AdaptiveAvgPool2d(1)
        for module in self.modules():
            if isinstance(module, nn.Conv2d):
                nn.init.kaiming_normal_(module.weight, mode="fan_out", nonlinearity="relu")

    def forward(self, pictures: torch.Tensor) -> torch.Tensor:
        """See the class."""
        x = self.maxpool(self.relu(self.bn1(self.conv1(pictures))))
        x = self.layer4(self.layer3(self.layer2(self.layer1(x))))
        return self.avgpool(x).flatten(1)
