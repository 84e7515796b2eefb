"""Training the gaze estimator on captures; resumable, its held-out error stored with the weights."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch.nn import functional as F

from gazenerf.data.captures import Capture
from gazenerf.errors import UserError
from gazenerf.training.estimator_loop import EpochSettings, labels_hash, train_epochs
from gazenerf.training.gaze_estimator import FINE, GazeEstimator, Layout, eye_window, overview, resized
from gazenerf.training.losses import angular_error, gaze_vectors

VISIBLE_SHARE = 2e-4
"""Share of the picture's pixels that must show an eye for the gaze to be readable."""

JITTER = 0.02
"""Share of the resized picture's side by which training moves the eye windows, at most."""

TURN, SCALE = 6.0, 0.08
"""Degrees by which training turns pictures in their plane, and share by which it changes their size, at most. Neither
changes the gaze in the head frame, nor the direction to the camera."""

SOFT, SOFTEST = 0.5, (100, 400)
"""Share of the pictures whose eye windows training takes down and back up, as smaller pictures are, and their sides."""

BLOCK = 256
"""Pictures that are kept in one tensor."""

MEASURE_EVERY = 10
"""Epochs between two measurements on held-out pictures."""


@dataclass(frozen=True)
class EstimatorData:
    """Pictures with a readable gaze, cut for an estimator, and what it should say about them.

    Attributes:
        layout: Of the estimator.
        small: (N, 3, .., ..) uint8 overviews.
        around: (N, 2, 3, .., ..) uint8 eye windows about the true places, with room to move them.
        gaze: (N, 2) radians.
        eyes: (N, 2, 2) eyeball centres in [-1, 1] over the picture, left then right.
        towards: (N, 3) unit, head frame.
        images: (N, 3, S, S) uint8 whole pictures, to be measured on; None where they are only learned from.
    """

    layout: Layout
    small: torch.Tensor
    around: torch.Tensor
    gaze: torch.Tensor
    eyes: torch.Tensor
    towards: torch.Tensor
    images: torch.Tensor | None = None

    def __len__(self) -> int:
        return len(self.gaze)

    @property
    def jitter(self) -> int:
        """Pixels of room on each side of the eye windows."""
        return (self.around.shape[-2] - self.layout.window[0]) // 2

    @classmethod
    def of(
        cls,
        captures: Iterable[Capture],
        eye_centres: Callable[[Capture], np.ndarray],
        layout: Layout = FINE,
        whole: bool = True,
    ) -> EstimatorData:
        """Summarise captures, leaving out those that show no eye.

        Args:
            eye_centres: Capture to (2, 3) eyeball centres, world units, left then right.
            layout: Of the estimator.
            whole: Keep whole pictures.

        Raises:
            UserError: no capture shows an eye.
        """
        margin = round(JITTER * layout.side)
        kept = _Blocks(), _Blocks(), _Blocks()
        gaze, eyes, towards = [], [], []
        for capture in captures:
            if not readable(capture):
                continue
            image = torch.from_numpy(capture.image).permute(2, 0, 1)[None].float()
            image = resized(image, layout.side).round().clamp(0, 255)
            camera = capture.camera
            pixels = camera.project(eye_centres(capture))[0] * 2.0 / np.array([camera.width, camera.height]) - 1.0
            places = torch.from_numpy(pixels).float()
            around = eye_window(image.expand(2, -1, -1, -1), places, layout.window, margin)
            kept[0].add(overview(image, layout)[0])
            kept[1].add(around)
            if whole:
                kept[2].add(image[0])
            gaze.append(capture.gaze.label)
            eyes.append(places)
            towards.append(camera.position / np.linalg.norm(camera.position))
        if not gaze:
            raise UserError("no capture shows an eye; synthesize views from the front")
        small, windows, images = (block.joined() for block in kept)
        assert small is not None and windows is not None
        return cls(
            layout, small, windows, torch.from_numpy(np.stack(gaze)).float(), torch.stack(eyes),
            torch.from_numpy(np.stack(towards)).float(), images,
        )  # fmt: skip


class _Blocks:
    """Tensors of one shape in few large ones: many small ones between large temporary ones would fragment the heap."""

    def __init__(self) -> None:
        self._blocks: list[torch.Tensor] = []
        self._count = 0

    def add(self, values: torch.Tensor) -> None:
        """Keep one more, as whole numbers."""
        row = self._count % BLOCK
        if row == 0:
            self._blocks.append(torch.empty(BLOCK, *values.shape, dtype=torch.uint8))
        self._blocks[-1][row] = values.round().to(torch.uint8)
        self._count += 1

    def joined(self) -> torch.Tensor | None:
        """(N, ...) all of them; None where there are none."""
        return torch.cat(self._blocks)[: self._count] if self._blocks else None


def readable(capture: Capture) -> bool:
    """Whether a capture shows enough of an eye to read its gaze."""
    return float((capture.parts >= 2).mean()) >= VISIBLE_SHARE


def gaze_errors(estimator: GazeEstimator, data: EstimatorData, batch: int = 64) -> np.ndarray:
    """(N,) angle in degrees between what the estimator reads and the truth."""
    return _errors(estimator, data, batch)[0]


def errors_of(estimator: GazeEstimator, data: EstimatorData, batch: int = 64) -> dict[str, Any]:
    """`error_summary` of the gaze, and under `head` that of the direction to the camera."""
    gaze, head = _errors(estimator, data, batch)
    return {**error_summary(gaze), "head": error_summary(head)}


def _errors(estimator: GazeEstimator, data: EstimatorData, batch: int) -> tuple[np.ndarray, np.ndarray]:
    estimator.eval()
    if data.images is None:
        raise ValueError("only whole pictures can be measured on")
    gaze, head = [], []
    with torch.no_grad():
        for first in range(0, len(data), batch):
            rows = slice(first, first + batch)
            read = estimator.read_both_ways(data.images[rows].float() / 255.0)
            gaze.append(angular_error(gaze_vectors(read.gaze), gaze_vectors(data.gaze[rows])))
            head.append(angular_error(read.towards, data.towards[rows]))
    return torch.rad2deg(torch.cat(gaze)).numpy(), torch.rad2deg(torch.cat(head)).numpy()


def error_summary(errors: np.ndarray) -> dict[str, float]:
    """Mean, median and 90th percentile, degrees."""
    return {
        "mean_deg": round(float(errors.mean()), 3),
        "median_deg": round(float(np.median(errors)), 3),
        "p90_deg": round(float(np.percentile(errors, 90)), 3),
        "pictures": len(errors),
    }


def train_gaze_estimator(
    data: EstimatorData,
    held_out: dict[str, EstimatorData],
    *,
    epochs: int = 60,
    batch: int = 32,
    learning_rate: float = 2e-3,
    seed: int = 0,
    initial: GazeEstimator | None = None,
    start: str = "",
    state: str | Path | None = None,
    about: dict[str, Any] | None = None,
    on_step: Callable[[int], None] = lambda _: None,
    on_epoch: Callable[[int, float, dict[str, dict[str, Any]]], None] | None = None,
) -> GazeEstimator:
    """Train from scratch, or from `state` when that file is there.

    Args:
        data: What to learn from.
        held_out: Named sets that are only measured; their errors go into `about`.
        epochs, batch, learning_rate: Of AdamW with a cosine schedule.
        initial: Weights to begin with, of the layout that the data are cut for; start: what they are called.
        state: Written after every epoch, to resume from.
        on_step: Called with the steps that are done.
        on_epoch: Called with (epochs done, mean loss, errors so far); errors are measured every tenth epoch.

    Raises:
        UserError: the state file belongs to another run or is damaged, or the loss is not finite.
    """
    torch.manual_seed(seed)
    estimator = GazeEstimator(data.layout)
    if initial is not None:
        estimator.load_state_dict(initial.state_dict())
    errors: dict[str, dict[str, Any]] = {}

    def loss_of(rows: torch.Tensor) -> torch.Tensor:
        return gaze_loss(estimator, data, rows)

    def after(epoch: int, loss: float) -> None:
        if epoch % MEASURE_EVERY == 0 and epoch < epochs:
            errors.update({name: errors_of(estimator, rest) for name, rest in held_out.items()})
        if on_epoch is not None:
            on_epoch(epoch, loss, errors)

    settings = EpochSettings(epochs, batch, learning_rate, seed)
    which = {"labels": labels_hash(data.gaze, data.towards), **({} if initial is None else {"from": start})}
    run = train_epochs(
        estimator, loss_of, len(data), settings, about=which, state=state, on_step=on_step, on_epoch=after
    )  # fmt: skip
    found = {name: errors_of(estimator, rest) for name, rest in held_out.items()}
    estimator.about = {"training": run, "held_out": found, **(about or {})}
    return estimator


def gaze_loss(estimator: GazeEstimator, data: EstimatorData, rows: torch.Tensor) -> torch.Tensor:
    """What the estimator misses on some pictures, which are varied: gaze, radians, where the eyes are, and head pose.

    Args:
        estimator: That learns.
        data: Pictures and truth.
        rows: (B,) indices.
    """
    small, windows, gaze, eyes, towards = _augmented(data, rows)
    read = estimator.read_windows(small, windows)
    return (
        angular_error(gaze_vectors(read.gaze), gaze_vectors(gaze)).mean()
        + 2.0 * (read.eyes - eyes).abs().mean()
        + 0.2 * angular_error(read.towards, towards).mean()
    )


def _augmented(
    data: EstimatorData, rows: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """A batch: overviews, eye windows, gaze, eyes, towards; moved, mirrored, colours and sharpness varied."""
    gaze, eyes, towards = data.gaze[rows].clone(), data.eyes[rows].clone(), data.towards[rows].clone()
    small, around = data.small[rows].float() / 255.0, data.around[rows].float() / 255.0
    n, (height, width) = len(rows), data.layout.window
    small, windows, eyes = _moved(small, around, eyes, data.layout.window, data.jitter)
    flip = torch.rand(n) < 0.5
    small[flip] = small[flip].flip(3)
    windows[flip] = windows[flip].flip((1, 4))
    gaze[flip, 1] *= -1.0
    eyes[flip] = eyes[flip].flip(1) * eyes.new_tensor([-1.0, 1.0])
    towards[flip, 0] *= -1.0
    soft = torch.rand(n) < SOFT
    if bool(soft.any()):
        factor = float(torch.empty(1).uniform_(*SOFTEST)) / data.layout.side
        less = F.interpolate(windows[soft].flatten(0, 1), scale_factor=factor, mode="area")
        blurred = F.interpolate(less, (height, width), mode="bilinear", align_corners=False)
        windows[soft] = blurred.reshape(-1, 2, 3, height, width)
    gain = 1.0 + 0.25 * (2.0 * torch.rand(n, 1, 1, 1) - 1.0) + 0.08 * torch.randn(n, 3, 1, 1)
    power = 1.0 + 0.3 * (2.0 * torch.rand(n, 1, 1, 1) - 1.0)
    small = small.clamp(min=1e-4) ** power * gain
    windows = windows.clamp(min=1e-4) ** power[:, None] * gain[:, None]
    small = (small + 0.01 * torch.randn_like(small)).clamp(0.0, 1.0)
    windows = (windows + 0.01 * torch.randn_like(windows)).clamp(0.0, 1.0)
    return small, windows, gaze, eyes, towards


def _moved(
    small: torch.Tensor, around: torch.Tensor, eyes: torch.Tensor, window: tuple[int, int], jitter: int
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Overviews (B, 3, S, S), eye windows (B, 2, 3, *window) and eyes (B, 2, 2) of pictures that are turned in their
    plane, smaller or larger, and whose windows are cut up to `jitter` pixels beside the eyes."""
    n, device = len(small), small.device
    angle = np.deg2rad(TURN) * (2.0 * torch.rand(n, device=device) - 1.0)
    size = 1.0 + SCALE * (2.0 * torch.rand(n, device=device) - 1.0)
    cos, sin = angle.cos(), angle.sin()
    turn = torch.stack([cos, -sin, sin, cos], dim=-1).reshape(n, 2, 2) * size[:, None, None]
    back = turn.inverse()
    none = torch.zeros(n, 2, 1, device=device)
    grid = F.affine_grid(torch.cat([back, none], dim=2), list(small.shape), align_corners=False)
    small = F.grid_sample(small, grid, align_corners=False)
    half = around.new_tensor([around.shape[-1] / 2.0, around.shape[-2] / 2.0])
    share = around.new_tensor([window[1] / 2.0, window[0] / 2.0])
    per_window = (back * share / half[:, None]).repeat_interleave(2, dim=0)
    shift = (2.0 * torch.rand(2 * n, 2, 1, device=device) - 1.0) * jitter / half[:, None]
    shape = [2 * n, 3, *window]
    grid = F.affine_grid(torch.cat([per_window, shift], dim=2), shape, align_corners=False)
    windows = F.grid_sample(around.flatten(0, 1), grid, padding_mode="border", align_corners=False)
    return small, windows.reshape(n, 2, 3, *window), eyes @ turn.transpose(1, 2)
