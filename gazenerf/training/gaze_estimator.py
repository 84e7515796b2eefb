"""A small network that reads the gaze, in the head frame, off a picture of a whole head.

It looks twice: once at the whole picture, small, to see how the head is turned and where the eyes
are, and once at a window around each eye at full resolution. It serves the functional loss (paper
Sec. 3.2) and the measurement of redirected pictures.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import torch
from safetensors.torch import save_file
from torch import nn
from torch.nn import functional as F

from gazenerf.files import parse_json, whole_file
from gazenerf.geometry import Camera
from gazenerf.tensor_files import TensorFileKind, open_tensors

FORMAT = "gazenerf-gaze-estimator-1"
BUNDLED = Path(__file__).parent.parent / "assets" / "gaze_estimator.safetensors"
MAX_BYTES = 64 * 2**20
KIND = TensorFileKind(
    "gaze estimator",
    FORMAT,
    MAX_BYTES,
    absent="train one with `gazenerf train-estimator --network small`",
    foreign="train one with `gazenerf train-estimator --network small`",
)


@dataclass(frozen=True)
class Layout:
    """Sizes of the network.

    Attributes:
        side: Pictures are resized to this side first.
        overview: Side of the small picture of the whole head.
        window: Height and width, in pixels of the resized picture, of the window around an eye.
        overview_layers, eye_layers: Channels and stride of each convolution.
        widths: Of the layers after them and after both.
    """

    side: int
    overview: int
    window: tuple[int, int]
    overview_layers: tuple[tuple[int, int], ...]
    eye_layers: tuple[tuple[int, int], ...]
    widths: tuple[int, int, int]


FINE = Layout(
    512, 96, (64, 96),
    ((24, 2), (48, 2), (64, 2), (64, 1), (96, 2)), ((32, 2), (48, 2), (96, 2), (96, 2)), (160, 128, 160),
)  # fmt: skip
"""About 1.3 million parameters."""

COARSE = Layout(
    256, 64, (32, 48),
    ((16, 2), (32, 2), (64, 2), (64, 1), (64, 2)), ((16, 1), (32, 2), (48, 2), (64, 2)), (128, 96, 128),
)  # fmt: skip
"""About 0.6 million; of files that do not state their side."""

LAYOUTS = {layout.side: layout for layout in (COARSE, FINE)}


class Reading(NamedTuple):
    """What the network says about pictures.

    Attributes:
        gaze: (B, 2) float32 pitch, yaw in radians, head frame.
        eyes: (B, 2, 2) float32 x, y of the eyeball centres, left then right (the subject's), in
            [-1, 1] over the picture.
        towards: (B, 3) float32 unit direction from the head's origin to the camera, head frame.
    """

    gaze: torch.Tensor
    eyes: torch.Tensor
    towards: torch.Tensor


def _block(inputs: int, outputs: int, stride: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, 3, stride, 1, bias=False), nn.BatchNorm2d(outputs), nn.ReLU(inplace=True)
    )


def _blocks(layers: Sequence[tuple[int, int]]) -> list[nn.Module]:
    inputs = (3, *(channels for channels, _ in layers[:-1]))
    return [_block(before, channels, stride) for before, (channels, stride) in zip(inputs, layers, strict=True)]


def _shrunk(side: int, layers: Sequence[tuple[int, int]]) -> int:
    return side // math.prod(stride for _, stride in layers)


class GazeEstimator(nn.Module):
    """See the module's docstring.

    Args:
        layout: Its sizes.

    Attributes:
        about: Training data and held-out error, JSON-able.
        knows_labels: Its angles are those of captures.
    """

    knows_labels = True

    def __init__(self, layout: Layout = FINE) -> None:
        super().__init__()
        self.layout = layout
        self.about: dict[str, Any] = {}
        whole, one, both = layout.widths
        cells = _shrunk(layout.overview, layout.overview_layers) ** 2
        self.overview = nn.Sequential(
            *_blocks(layout.overview_layers), nn.Flatten(),
            nn.Linear(layout.overview_layers[-1][0] * cells, whole), nn.ReLU(inplace=True),
        )  # fmt: skip
        self.place = nn.Linear(whole, 4 + 3)
        cells = math.prod(_shrunk(side, layout.eye_layers) for side in layout.window)
        self.eye = nn.Sequential(
            *_blocks(layout.eye_layers), nn.Flatten(),
            nn.Dropout(0.2), nn.Linear(layout.eye_layers[-1][0] * cells, one), nn.ReLU(inplace=True),
        )  # fmt: skip
        self.head = nn.Sequential(nn.Linear(2 * one + whole + 7, both), nn.ReLU(inplace=True), nn.Linear(both, 2))

    def forward(self, images: torch.Tensor) -> torch.Tensor:
        """Gaze (B, 2) of sRGB pictures (B, 3, H, W) in [0, 1] on black: `read_both_ways(images).gaze`."""
        return self.read_both_ways(images).gaze

    def read(self, images: torch.Tensor, eyes: torch.Tensor | None = None) -> Reading:
        """Everything the network says of pictures, looked at once.

        Args:
            images: (B, 3, H, W) sRGB in [0, 1], square, the head as a neutral camera sees it.
            eyes: (B, 2, 2) where to look instead of where the network found the eyes (training).
        """
        images = resized(images, self.layout.side)
        small = overview(images, self.layout)
        whole = self.overview(small - 0.5)
        placed = self.place(whole).float()
        found = placed[:, :4].reshape(-1, 2, 2)
        looked_at = found.detach() if eyes is None else eyes
        windows = torch.stack([eye_window(images, looked_at[:, i], self.layout.window) for i in (0, 1)], dim=1)
        return self.read_windows(small, windows, (whole, placed))

    def read_both_ways(self, images: torch.Tensor) -> Reading:
        """The mean of what the network says of pictures, see `read`, and of their mirror images: it errs less.

        A mirrored picture reads as the mirrored gaze, exactly.
        """
        seen, mirrored = self.read(images), self.read(images.flip(3))
        other = mirrored.gaze.new_tensor([-1.0, 1.0])
        gaze = 0.5 * (seen.gaze + mirrored.gaze * other.flip(0))
        eyes = 0.5 * (seen.eyes + mirrored.eyes.flip(1) * other)
        towards = seen.towards + mirrored.towards * mirrored.towards.new_tensor([-1.0, 1.0, 1.0])
        return Reading(gaze, eyes, F.normalize(towards, dim=1))

    def read_views(self, images: torch.Tensor, camera: Camera) -> tuple[torch.Tensor, torch.Tensor]:
        """Gaze (B, 2) and direction to the camera (B, 3), see `Reading`, of pictures (B, 3, H, W) from one camera.

        This network finds the head itself and does not look at the camera.
        """
        reading = self.read_both_ways(images)
        return reading.gaze, reading.towards

    def read_windows(
        self, small: torch.Tensor, windows: torch.Tensor, known: tuple[torch.Tensor, torch.Tensor] | None = None
    ) -> Reading:
        """`read` from overviews (B, 3, .., ..) and eye windows (B, 2, 3, .., ..) cut already; sizes: see `Layout`.

        Args:
            known: What the overview gave, when it was read before.
        """
        if known is None:
            whole = self.overview(small - 0.5)
            placed = self.place(whole).float()
        else:
            whole, placed = known
        mean = windows.mean((2, 3, 4), keepdim=True)
        evened = (windows - mean) / (windows.std((2, 3, 4), keepdim=True) + 0.05)
        left, right = self.eye(torch.cat([evened[:, 0], evened[:, 1].flip(3)])).chunk(2)
        gaze = self.head(torch.cat([left, right, whole, placed.detach().to(left.dtype)], dim=1)).float()
        return Reading(gaze, placed[:, :4].reshape(-1, 2, 2), F.normalize(placed[:, 4:], dim=1))


def resized(images: torch.Tensor, side: int) -> torch.Tensor:
    """Pictures (B, C, H, W) as (B, C, side, side)."""
    if images.shape[-1] == side and images.shape[-2] == side:
        return images
    return F.interpolate(images, (side, side), mode="bilinear", antialias=True, align_corners=False)


def overview(images: torch.Tensor, layout: Layout) -> torch.Tensor:
    """The small pictures of whole heads."""
    return F.interpolate(images, (layout.overview, layout.overview), mode="area")


def eye_window(images: torch.Tensor, centre: torch.Tensor, window: tuple[int, int], margin: int = 0) -> torch.Tensor:
    """Square pictures (B, 3, S, S) cut about points (B, 2) in [-1, 1]: (B, 3, *window), `margin` px more a side."""
    height, width = window[0] + 2 * margin, window[1] + 2 * margin
    x = (torch.arange(width, device=images.device) - (width - 1) / 2) * (2.0 / images.shape[-1])
    y = (torch.arange(height, device=images.device) - (height - 1) / 2) * (2.0 / images.shape[-1])
    offsets = torch.stack(torch.meshgrid(x, y, indexing="xy"), dim=-1)
    grid = centre[:, None, None] + offsets[None]
    with torch.autocast(images.device.type, enabled=False):
        return F.grid_sample(images.float(), grid.float(), mode="bilinear", align_corners=False)


def save_gaze_estimator(estimator: GazeEstimator, path: str | Path) -> None:
    """Write an estimator as one safetensors file, floating-point weights as float16."""
    tensors = {
        name: (value.detach().cpu().half() if value.is_floating_point() else value.detach().cpu()).contiguous()
        for name, value in estimator.state_dict().items()
    }
    with whole_file(path) as temporary:
        metadata = {"format": FORMAT, "side": str(estimator.layout.side), "about": json.dumps(estimator.about)}
        save_file(tensors, temporary, metadata=metadata)


def load_gaze_estimator(path: str | Path | None = None) -> GazeEstimator:
    """A frozen estimator; the bundled one when `path` is None. Calling it gives gaze (B, 2).

    Raises:
        UserError: missing, too large, damaged, of other shapes, or not finite.
    """
    path = BUNDLED if path is None else Path(path)
    with open_tensors(path, KIND, "pt") as (file, metadata):
        about = parse_json(metadata["about"])
        weights = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
        side = metadata.get("side", str(COARSE.side))
        if side not in {str(known) for known in LAYOUTS}:
            raise ValueError(f"it is for pictures of {side[:20]} px; {' or '.join(map(str, LAYOUTS))} are possible")
        estimator = GazeEstimator(LAYOUTS[int(side)])
        for name, value in weights.items():
            if value.is_floating_point() and not bool(torch.isfinite(value).all()):
                raise ValueError(f"{name} holds NaN or infinite values")
        estimator.load_state_dict(weights)
    estimator.about = about
    return estimator.eval().requires_grad_(False)


def estimate_gaze(images: torch.Tensor, estimator: GazeEstimator | None = None) -> torch.Tensor:
    """Gaze (B, 2) = (pitch up, yaw left) radians, head frame, of sRGB pictures (B, 3, H, W) in [0, 1].

    Differentiable in the pictures.

    Raises:
        UserError: no estimator is given and none is bundled.
    """
    return (load_gaze_estimator() if estimator is None else estimator)(images)
