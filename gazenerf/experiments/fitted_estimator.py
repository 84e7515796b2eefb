"""An estimator that is fitted to a few pictures of a person."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Protocol

import torch

from gazenerf.data.captures import Capture
from gazenerf.devices import choose_device
from gazenerf.errors import UserError
from gazenerf.head_model import load_head_model
from gazenerf.training.estimators import load_view_reader
from gazenerf.training.gaze_estimator import GazeEstimator
from gazenerf.training.gaze_training import EstimatorData, errors_of, gaze_loss
from gazenerf.training.pose_estimator import PoseEstimator
from gazenerf.training.pose_training import PoseData, pose_errors, pose_loss

LEARNING_RATE = 1e-4
BATCH = 16


class FittedEstimator(Protocol):
    """An estimator of gaze, which can be fitted further."""

    def error(self, captures: Sequence[Capture]) -> float:
        """Mean angle, degrees, between the gazes that it reads and the labels."""
        ...

    def fitted(self, captures: Sequence[Capture], steps: int, seed: int) -> FittedEstimator:
        """A copy that has learned from captures in so many steps; this one stays as it is."""
        ...


def open_estimator(path: Path, device: str) -> FittedEstimator:
    """The estimator in a file of `gazenerf train-estimator`.

    Raises:
        UserError: it cannot be read, or its angles are its own.
    """
    reader = load_view_reader(path)
    if isinstance(reader, GazeEstimator):
        return _Small(reader)
    if isinstance(reader, PoseEstimator) and reader.knows_labels:
        return _Pose(reader, choose_device(device))
    raise UserError(f"{path} cannot be calibrated; train one with `gazenerf train-estimator`")


class _Small:
    """The small network; it learns on the CPU."""

    def __init__(self, network: GazeEstimator) -> None:
        self._network, self._head_model = network, load_head_model()

    def error(self, captures: Sequence[Capture]) -> float:
        return float(errors_of(self._network, self._data(captures))["mean_deg"])

    def fitted(self, captures: Sequence[Capture], steps: int, seed: int) -> FittedEstimator:
        network, data = copy.deepcopy(self._network), self._data(captures)
        _fit(network, lambda rows: gaze_loss(network, data, rows), len(data), steps, seed)
        return _Small(network)

    def _data(self, captures: Sequence[Capture]) -> EstimatorData:
        layout = self._network.layout
        return EstimatorData.of(captures, lambda capture: self._head_model.eye_centres(capture.codes.identity), layout)


class _Pose:
    """ResNet50."""

    def __init__(self, network: PoseEstimator, device: torch.device) -> None:
        self._network, self._device = network.to(device), device

    def error(self, captures: Sequence[Capture]) -> float:
        return float(pose_errors(self._network, PoseData.of(captures), self._device)["mean_deg"])

    def fitted(self, captures: Sequence[Capture], steps: int, seed: int) -> FittedEstimator:
        network, data = copy.deepcopy(self._network), PoseData.of(captures)
        _fit(network, lambda rows: pose_loss(network, data, rows, self._device), len(data), steps, seed)
        return _Pose(network, self._device)


def _fit(network: Any, loss_of: Callable[[torch.Tensor], torch.Tensor], count: int, steps: int, seed: int) -> None:
    """Fit a network in place. Its normalisation keeps the statistics it has: a few pictures of one person have none.

    Raises:
        UserError: the loss is not finite.
    """
    torch.manual_seed(seed)
    network.eval().requires_grad_(True)
    optimizer = torch.optim.AdamW(network.parameters(), lr=LEARNING_RATE)
    for _ in range(steps):
        loss = loss_of(torch.randint(0, count, (BATCH,)))
        if not bool(torch.isfinite(loss)):
            raise UserError("the loss of the estimator's calibration is not finite")
        optimizer.zero_grad(set_to_none=True)
        loss.backward()
        optimizer.step()
    network.requires_grad_(False)
