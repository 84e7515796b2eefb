"""The neural renderer at rendering time: the same picture with fewer operations, by backend.

`NeuralRenderer` is the slow reference. `FoldedRenderer` computes the same to rounding: the blur and the
narrowing convolution are both linear and exchange places, so the blur runs on the narrow map; the pixel
shuffle becomes an order of rows; the repeated input of a block is folded into one matrix. `openvino`
runs that graph in OpenVINO where it is installed.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from typing import Any, cast

import torch
import torch.nn.functional as F
from torch import nn

from gazenerf.errors import UserError
from gazenerf.field.neural_renderer import SLOPE, NeuralRenderer, blur_kernel, narrowed_repeat, sub_pixels_first

Upsampler = Callable[[torch.Tensor], torch.Tensor]
"""Feature map (B, C, h, w) float32 to sRGB pictures (B, 3, h * k, w * k) in (0, 1)."""

BACKENDS = ("reference", "folded", "openvino")

REACH = 3
"""Feature pixels from which a picture pixel is made, at most: half as many more with each doubling."""

WINDOW = 0.85
"""Share of the picture above which a window is not worth its seams."""


def upsample_window(
    upsample: Upsampler, features: torch.Tensor, seen: torch.Tensor, behind: Callable[[], torch.Tensor]
) -> torch.Tensor:
    """The picture of a feature map that shows the background but in some places: only these are up-sampled.

    Args:
        upsample: The neural renderer.
        features: (1, C, h, w).
        seen: (h, w) bool, where the features may differ from the background's.
        behind: Gives the picture (3, h * k, w * k) of the background's features alone.

    Returns:
        (3, h * k, w * k), as `upsample(features)[0]`.
    """
    height, width = seen.shape
    spans = []
    for axis, size in ((1, height), (0, width)):
        along = seen.any(axis).nonzero()[:, 0].tolist()
        if not along:
            return behind().clone()
        spans.append((max(0, along[0] - REACH), min(size, along[-1] + 1 + REACH), size))
    if (spans[0][1] - spans[0][0]) * (spans[1][1] - spans[1][0]) > WINDOW * height * width:
        return upsample(features)[0]
    (top, bottom, left, right), (up, down, before, after) = (
        tuple(value for first, last, size in spans for value in (max(0, first - grown), min(size, last + grown)))
        for grown in (0, REACH)
    )
    part = upsample(features[:, :, up:down, before:after].contiguous())[0]
    picture = behind().clone()
    k = picture.shape[1] // height
    picture[:, k * top : k * bottom, k * left : k * right] = part[
        :, k * (top - up) : k * (bottom - up), k * (left - before) : k * (right - before)
    ]
    return picture


class FoldedRenderer(nn.Module):
    """`NeuralRenderer` with everything constant folded; weights are copied, so build it after training.

    Args:
        renderer: What it computes.
    """

    def __init__(self, renderer: NeuralRenderer) -> None:
        super().__init__()
        self.steps = nn.ModuleList()
        first = renderer.to_rgb[0]
        assert isinstance(first, nn.Conv2d)
        self.rgb = _linear(first)
        for upsample, narrow, to_rgb in zip(renderer.upsample, renderer.narrow, list(renderer.to_rgb)[1:], strict=True):
            self.steps.append(_Step(upsample, narrow, to_rgb))

    def forward(self, features: torch.Tensor) -> torch.Tensor:
        """See `Upsampler`; float32 whatever autocast says."""
        rows = features.permute(0, 2, 3, 1)
        rgb = self.rgb(rows).permute(0, 3, 1, 2)
        for step in self.steps:
            rows, rgb = step(rows, rgb)
        return torch.sigmoid(rgb)


class _Step(nn.Module):
    """One doubling: rows (B, h, w, C) and picture (B, 3, h, w) to (B, 2h, 2w, C') and (B, 3, 2h, 2w)."""

    def __init__(self, upsample: Any, narrow: Any, to_rgb: Any) -> None:
        super().__init__()
        channels, out = narrow.in_channels, narrow.out_channels
        self.out = out
        self.widen_0, self.widen_1 = _linear(upsample.widen_0), _linear(upsample.widen_1)
        self.widen_1.weight.data = sub_pixels_first(self.widen_1.weight.data)
        self.widen_1.bias.data = sub_pixels_first(self.widen_1.bias.data)
        self.narrow = nn.Linear(channels, out, bias=False)
        self.narrow.weight.data = narrow.weight.detach().flatten(1).clone()
        self.around = nn.Linear(channels, 4 * out)
        self.around.weight.data = narrowed_repeat(self.narrow.weight.data)
        self.around.bias.data = narrow.bias.detach().repeat(4)
        self.rgb = _linear(to_rgb)
        self.blur_features, self.blur_rgb = _Blur(out).to(narrow.weight.device), _Blur(3).to(narrow.weight.device)
        self.requires_grad_(False)

    def forward(self, rows: torch.Tensor, rgb: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        batch, height, width, channels = rows.shape
        wide = F.leaky_relu(self.widen_0(rows), SLOPE, inplace=True)
        wide = F.leaky_relu(self.widen_1(wide), SLOPE, inplace=True).reshape(-1, channels)
        fine = torch.addmm(self.around(rows).reshape(-1, self.out), wide, self.narrow.weight.T)
        fine = fine.reshape(batch, height, width, 2, 2, self.out).permute(0, 1, 3, 2, 4, 5)
        fine = fine.reshape(batch, 2 * height, 2 * width, self.out).permute(0, 3, 1, 2)
        rows = F.leaky_relu(self.blur_features(fine), SLOPE, inplace=True).permute(0, 2, 3, 1)
        rgb = self.blur_rgb(F.interpolate(rgb, scale_factor=2, mode="bilinear", align_corners=False))
        return rows, rgb + self.rgb(rows).permute(0, 3, 1, 2)


class _Blur(nn.Module):
    def __init__(self, channels: int) -> None:
        super().__init__()
        self.channels = channels
        self.register_buffer("kernel", blur_kernel(channels).contiguous(), persistent=False)

    def forward(self, images: torch.Tensor) -> torch.Tensor:
        kernel = cast(torch.Tensor, self.kernel)
        return F.conv2d(F.pad(images, (1, 1, 1, 1), mode="reflect"), kernel, groups=self.channels)


def _linear(convolution: Any) -> nn.Linear:
    """A 1x1 convolution as a linear layer of rows, weights copied."""
    layer = nn.Linear(convolution.in_channels, convolution.out_channels)
    layer.weight.data = convolution.weight.detach().flatten(1).clone()
    layer.bias.data = convolution.bias.detach().clone()
    return layer.requires_grad_(False)


def has_openvino() -> bool:
    """Is OpenVINO installed (`pip install gazenerf[fast]`)?"""
    return importlib.util.find_spec("openvino") is not None


def make_upsampler(renderer: NeuralRenderer, backend: str | None = None) -> Upsampler:
    """The renderer by a backend.

    Args:
        renderer: With its final weights.
        backend: One of `BACKENDS`; None takes `openvino` where installed, else `folded`.

    Raises:
        UserError: unknown backend, or OpenVINO is not installed.
    """
    if backend is None:
        backend = "openvino" if has_openvino() else "folded"
    if backend == "reference":
        return renderer
    if backend == "folded":
        return FoldedRenderer(renderer).eval()
    if backend != "openvino":
        raise UserError(f"unknown up-sampler {backend!r}; choose {', '.join(BACKENDS)}")
    if not has_openvino():
        raise UserError("OpenVINO is not installed; pip install 'gazenerf[fast]' or choose the folded up-sampler")
    return _openvino(renderer)


def _openvino(renderer: NeuralRenderer) -> Upsampler:
    import openvino  # pyright: ignore[reportMissingImports]

    size, channels = 8, renderer.background_features.shape[1]
    with torch.no_grad():
        model = openvino.convert_model(renderer, example_input=torch.zeros(1, channels, size, size))
    settings = {
        "INFERENCE_NUM_THREADS": torch.get_num_threads(),
        "INFERENCE_PRECISION_HINT": "f32",
        "PERFORMANCE_HINT": "LATENCY",
    }
    compiled = openvino.Core().compile_model(model, "CPU", settings)

    def run(features: torch.Tensor) -> torch.Tensor:
        return torch.from_numpy(compiled(features.contiguous().numpy())[0].copy())

    return run
