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
from gazenerf.training.gaze_estimator import INPUT, OVERVIEW, WINDOW, GazeEstimator, eye_window
from gazenerf.training.losses import angular_error, gaze_vectors

VISIBLE_SHARE = 2e-4
"""Share of the picture's pixels that must show an eye for the gaze to be readable."""

JITTER = 5
"""Whole pixels of the resized picture by which training moves the eye windows, at most."""

SOFTEST = (0.4, 0.8)
"""Shares of their size to which training takes some eye windows down and back up, as smaller pictures are."""

MEASURE_EVERY = 10
"""Epochs between two measurements on held-out pictures."""


@dataclass(frozen=True)
class EstimatorData:
    """Pictures with a readable gaze, and what the estimator should say about them.

    Attributes:
        images: (N, 3, INPUT, INPUT) uint8.
        gaze: (N, 2) radians.
        eyes: (N, 2, 2) eyeball centres in [-1, 1] over the picture, left then right.
        towards: (N, 3) unit, head frame.
    """

    images: torch.Tensor
    gaze: torch.Tensor
    eyes: torch.Tensor
    towards: torch.Tensor

    def __len__(self) -> int:
        return len(self.images)

    @classmethod
    def of(cls, captures: Iterable[Capture], eye_centres: Callable[[Capture], np.ndarray]) -> EstimatorData:
        """Summarise captures, leaving out those that show no eye.

        Args:
            eye_centres: Capture to (2, 3) eyeball centres, world units, left then right.

        Raises:
            UserError: no capture shows an eye.
        """
        images, gaze, eyes, towards = [], [], [], []
        for capture in captures:
            if not readable(capture):
                continue
            image = torch.from_numpy(capture.image).permute(2, 0, 1)[None].float()
            if image.shape[-1] != INPUT or image.shape[-2] != INPUT:
                image = F.interpolate(image, (INPUT, INPUT), mode="bilinear", antialias=True, align_corners=False)
            images.append(image.round().clamp(0, 255).to(torch.uint8))
            gaze.append(capture.gaze.label)
            camera = capture.camera
            pixels = camera.project(eye_centres(capture))[0]
            eyes.append(pixels * 2.0 / np.array([camera.width, camera.height]) - 1.0)
            towards.append(camera.position / np.linalg.norm(camera.position))
        if not images:
            raise UserError("no capture shows an eye; synthesize views from the front")
        return cls(
            torch.cat(images),
            torch.from_numpy(np.stack(gaze)).float(),
            torch.from_numpy(np.stack(eyes)).float(),
            torch.from_numpy(np.stack(towards)).float(),
        )


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
    gaze, head = [], []
    with torch.no_grad():
        for first in range(0, len(data), batch):
            rows = slice(first, first + batch)
            read = estimator.read(data.images[rows].float() / 255.0)
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
        state: Written after every epoch, to resume from.
        on_step: Called with the steps that are done.
        on_epoch: Called with (epochs done, mean loss, errors so far); errors are measured every tenth epoch.

    Raises:
        UserError: the state file belongs to another run or is damaged, or the loss is not finite.
    """
    torch.manual_seed(seed)
    estimator, cuts = GazeEstimator(), Cuts.of(data)
    errors: dict[str, dict[str, Any]] = {}

    def loss_of(rows: torch.Tensor) -> torch.Tensor:
        return gaze_loss(estimator, data, cuts, rows)

    def after(epoch: int, loss: float) -> None:
        if epoch % MEASURE_EVERY == 0 and epoch < epochs:
            errors.update({name: errors_of(estimator, rest) for name, rest in held_out.items()})
        if on_epoch is not None:
            on_epoch(epoch, loss, errors)

    settings = EpochSettings(epochs, batch, learning_rate, seed)
    which = {"labels": labels_hash(data.gaze, data.towards)}
    run = train_epochs(
        estimator, loss_of, len(data), settings, about=which, state=state, on_step=on_step, on_epoch=after
    )  # fmt: skip
    found = {name: errors_of(estimator, rest) for name, rest in held_out.items()}
    estimator.about = {"training": run, "held_out": found, **(about or {})}
    return estimator


def gaze_loss(estimator: GazeEstimator, data: EstimatorData, cuts: Cuts, rows: torch.Tensor) -> torch.Tensor:
    """What the estimator misses on some pictures, which are varied: gaze, radians, where the eyes are, and head pose.

    Args:
        estimator: That learns.
        data: Pictures and truth.
        cuts: The pictures' parts.
        rows: (B,) indices.
    """
    small, windows, gaze, eyes, towards = _augmented(data, cuts, rows)
    read = estimator.read_windows(small, windows)
    return (
        angular_error(gaze_vectors(read.gaze), gaze_vectors(gaze)).mean()
        + 2.0 * (read.eyes - eyes).abs().mean()
        + 0.2 * angular_error(read.towards, towards).mean()
    )


@dataclass(frozen=True)
class Cuts:
    """The parts of pictures that training looks at, cut once: small (N, 3, .., ..), eyes (N, 2, 3, .., ..), uint8."""

    small: torch.Tensor
    eyes: torch.Tensor

    @classmethod
    def of(cls, data: EstimatorData) -> Cuts:
        """Cut the parts of pictures."""
        small, eyes = [], []
        for first in range(0, len(data), 64):
            images = data.images[first : first + 64].float()
            places = data.eyes[first : first + 64]
            small.append(F.interpolate(images, (OVERVIEW, OVERVIEW), mode="area").round().to(torch.uint8))
            cut = torch.stack([eye_window(images, places[:, i], JITTER) for i in (0, 1)], dim=1)
            eyes.append(cut.round().to(torch.uint8))
        return cls(torch.cat(small), torch.cat(eyes))


def _augmented(
    data: EstimatorData, cuts: Cuts, rows: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """A batch: overviews, eye windows, gaze, eyes, towards; moved, mirrored, colours and sharpness varied."""
    gaze, eyes, towards = data.gaze[rows].clone(), data.eyes[rows].clone(), data.towards[rows].clone()
    small, around = cuts.small[rows].float() / 255.0, cuts.eyes[rows].float() / 255.0
    n = len(rows)
    windows = around.new_empty(n, 2, 3, *WINDOW)
    moves = torch.randint(0, 2 * JITTER + 1, (n, 2, 2)).tolist()
    for i in range(n):
        for k, (row, column) in enumerate(moves[i]):
            windows[i, k] = around[i, k, :, row : row + WINDOW[0], column : column + WINDOW[1]]
    flip = torch.rand(n) < 0.5
    small[flip] = small[flip].flip(3)
    windows[flip] = windows[flip].flip((1, 4))
    gaze[flip, 1] *= -1.0
    eyes[flip] = eyes[flip].flip(1) * eyes.new_tensor([-1.0, 1.0])
    towards[flip, 0] *= -1.0
    soft = torch.rand(n) < 0.4
    if bool(soft.any()):
        factor = float(torch.empty(1).uniform_(*SOFTEST))
        less = F.interpolate(windows[soft].flatten(0, 1), scale_factor=factor, mode="area")
        blurred = F.interpolate(less, WINDOW, mode="bilinear", align_corners=False)
        windows[soft] = blurred.reshape(-1, 2, 3, *WINDOW)
    gain = 1.0 + 0.25 * (2.0 * torch.rand(n, 1, 1, 1) - 1.0) + 0.08 * torch.randn(n, 3, 1, 1)
    power = 1.0 + 0.3 * (2.0 * torch.rand(n, 1, 1, 1) - 1.0)
    small = small.clamp(min=1e-4) ** power * gain
    windows = windows.clamp(min=1e-4) ** power[:, None] * gain[:, None]
    small = (small + 0.01 * torch.randn_like(small)).clamp(0.0, 1.0)
    windows = (windows + 0.01 * torch.randn_like(windows)).clamp(0.0, 1.0)
    return small, windows, gaze, eyes, towards
