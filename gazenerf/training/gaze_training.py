"""Training the gaze estimator on captures; resumable, its held-out error stored with the weights."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch.nn import functional as F

from gazenerf.data.captures import Capture
from gazenerf.errors import UserError
from gazenerf.files import whole_file
from gazenerf.training.gaze_estimator import INPUT, OVERVIEW, WINDOW, GazeEstimator, eye_window
from gazenerf.training.losses import angular_error, gaze_vectors

VISIBLE_SHARE = 2e-4
"""Share of the picture's pixels that must show an eye for the gaze to be readable."""

JITTER = 5
"""Whole pixels of the resized picture by which training moves the eye windows, at most."""


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
    estimator.eval()
    found = []
    with torch.no_grad():
        for first in range(0, len(data), batch):
            rows = slice(first, first + batch)
            read = estimator(data.images[rows].float() / 255.0)
            found.append(torch.rad2deg(angular_error(gaze_vectors(read), gaze_vectors(data.gaze[rows]))))
    return torch.cat(found).numpy()


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
    on_epoch: Callable[[int, float, dict[str, dict[str, float]]], None] | None = None,
) -> GazeEstimator:
    """Train from scratch, or from `state` when that file is there.

    Args:
        data: What to learn from.
        held_out: Named sets that are only measured; their errors go into `about`.
        epochs, batch, learning_rate: Of AdamW with a cosine schedule.
        state: Written after every epoch, to resume from.
        on_epoch: Called with (epochs done, mean loss, errors so far); errors are measured every tenth epoch.

    Raises:
        UserError: the state file belongs to another run or is damaged, or the loss is not finite.
    """
    torch.manual_seed(seed)
    estimator = GazeEstimator()
    optimizer = torch.optim.AdamW(estimator.parameters(), lr=learning_rate, weight_decay=1e-3)
    first = 0
    run = {"epochs": epochs, "batch": batch, "learning_rate": learning_rate, "seed": seed, "pictures": len(data)}
    if state is not None and Path(state).is_file():
        try:
            saved = torch.load(state, map_location="cpu", weights_only=True)
            if saved["run"] != run:
                raise UserError(f"{state} belongs to another run; delete it or repeat that run's settings")
            estimator.load_state_dict(saved["estimator"])
            optimizer.load_state_dict(saved["optimizer"])
            first = int(saved["epoch"])
        except UserError:
            raise
        except Exception as error:
            raise UserError(f"cannot resume from {state}: {error}; delete it") from error
    cuts = _Cuts.of(data)
    steps = math.ceil(len(data) / batch)
    errors: dict[str, dict[str, float]] = {}
    for epoch in range(first, epochs):
        estimator.train()
        torch.manual_seed(seed * 7919 + epoch + 1)
        order = torch.randperm(len(data))
        losses = []
        for step in range(steps):
            rows = order[step * batch : (step + 1) * batch]
            if len(rows) < 2:
                continue
            share = (epoch + step / steps) / epochs
            for group in optimizer.param_groups:
                warm = min(1.0, (epoch * steps + step + 1) / 50)
                group["lr"] = learning_rate * warm * (0.02 + 0.98 * 0.5 * (1 + math.cos(math.pi * share)))
            small, windows, gaze, eyes, towards = _augmented(data, cuts, rows)
            read = estimator.read_windows(small, windows)
            loss = (
                angular_error(gaze_vectors(read.gaze), gaze_vectors(gaze)).mean()
                + 2.0 * (read.eyes - eyes).abs().mean()
                + 0.2 * angular_error(read.towards, towards).mean()
            )
            if not torch.isfinite(loss):
                raise UserError(f"the loss is not finite in epoch {epoch + 1}; lower the learning rate")
            optimizer.zero_grad(set_to_none=True)
            loss.backward()
            torch.nn.utils.clip_grad_norm_(estimator.parameters(), 2.0)
            optimizer.step()
            losses.append(float(loss.detach()))
        if state is not None:
            with whole_file(state) as temporary:
                torch.save(
                    {
                        "estimator": estimator.state_dict(),
                        "optimizer": optimizer.state_dict(),
                        "epoch": epoch + 1,
                        "run": run,
                    },
                    temporary,
                )
        if (epoch + 1) % 10 == 0 and epoch + 1 < epochs:
            errors = {name: error_summary(gaze_errors(estimator, rest)) for name, rest in held_out.items()}
        if on_epoch is not None:
            on_epoch(epoch + 1, float(np.mean(losses)), errors)
    errors = {name: error_summary(gaze_errors(estimator, rest)) for name, rest in held_out.items()}
    estimator.about = {"training": run, "held_out": errors, **(about or {})}
    return estimator.eval()


@dataclass(frozen=True)
class _Cuts:
    """The parts of pictures that training looks at, cut once: small (N, 3, .., ..), eyes (N, 2, 3, .., ..), uint8."""

    small: torch.Tensor
    eyes: torch.Tensor

    @classmethod
    def of(cls, data: EstimatorData) -> _Cuts:
        small, eyes = [], []
        for first in range(0, len(data), 64):
            images = data.images[first : first + 64].float()
            places = data.eyes[first : first + 64]
            small.append(F.interpolate(images, (OVERVIEW, OVERVIEW), mode="area").round().to(torch.uint8))
            cut = torch.stack([eye_window(images, places[:, i], JITTER) for i in (0, 1)], dim=1)
            eyes.append(cut.round().to(torch.uint8))
        return cls(torch.cat(small), torch.cat(eyes))


def _augmented(
    data: EstimatorData, cuts: _Cuts, rows: torch.Tensor
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
    soft = torch.rand(n) < 0.3
    if bool(soft.any()):
        less = F.interpolate(windows[soft].flatten(0, 1), scale_factor=0.5, mode="area")
        blurred = F.interpolate(less, WINDOW, mode="bilinear", align_corners=False)
        windows[soft] = blurred.reshape(-1, 2, 3, *WINDOW)
    gain = 1.0 + 0.25 * (2.0 * torch.rand(n, 1, 1, 1) - 1.0) + 0.08 * torch.randn(n, 3, 1, 1)
    power = 1.0 + 0.3 * (2.0 * torch.rand(n, 1, 1, 1) - 1.0)
    small = small.clamp(min=1e-4) ** power * gain
    windows = windows.clamp(min=1e-4) ** power[:, None] * gain[:, None]
    small = (small + 0.01 * torch.randn_like(small)).clamp(0.0, 1.0)
    windows = (windows + 0.01 * torch.randn_like(windows)).clamp(0.0, 1.0)
    return small, windows, gaze, eyes, towards
