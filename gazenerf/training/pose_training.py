"""Training of the ResNet50 that reads gaze and head pose, on patches of captures."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from gazenerf.data.captures import Capture
from gazenerf.errors import UserError
from gazenerf.training.face_patch import face_patch
from gazenerf.training.gaze_training import error_summary, readable
from gazenerf.training.losses import angular_error, gaze_vectors
from gazenerf.training.pose_estimator import PoseEstimator

MOVE = 8
"""Pixels by which training moves patches, at most."""


@dataclass(frozen=True)
class PoseData:
    """Patches with a readable gaze, and what the estimator should say about them.

    Attributes:
        patches: (N, 3, 224, 224) uint8.
        gaze: (N, 2) radians.
        towards: (N, 3) unit, head frame.
    """

    patches: torch.Tensor
    gaze: torch.Tensor
    towards: torch.Tensor

    def __len__(self) -> int:
        return len(self.patches)

    @classmethod
    def of(cls, captures: Iterable[Capture]) -> PoseData:
        """Patches of captures, leaving out those that show no eye.

        Raises:
            UserError: no capture shows an eye.
        """
        patches, gaze, towards = [], [], []
        for capture in captures:
            if readable(capture):
                alone = capture.image * capture.head_mask[..., None].astype(np.uint8)
                patches.append(torch.from_numpy(face_patch(alone, capture.camera)).permute(2, 0, 1))
                gaze.append(capture.gaze.label)
                towards.append(capture.camera.position / np.linalg.norm(capture.camera.position))
        if not patches:
            raise UserError("no capture shows an eye; synthesize views from the front")
        labels = [torch.from_numpy(np.stack(values)).float() for values in (gaze, towards)]
        return cls(torch.stack(patches), *labels)


def pose_loss(estimator: PoseEstimator, data: PoseData, rows: torch.Tensor, device: torch.device) -> torch.Tensor:
    """Mean angle of gaze and of head pose, radians, over some patches, which are varied."""
    patches, gaze, towards = (value.to(device) for value in augmented(data, rows))
    pose = estimator(patches)
    return (
        angular_error(gaze_vectors(pose.gaze), gaze_vectors(gaze)).mean()
        + angular_error(gaze_vectors(pose.head), towards).mean()
    )


def augmented(data: PoseData, rows: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Patches (B, 3, 224, 224) in [0, 1], gaze and towards: moved, mirrored, colours varied."""
    gaze, towards = data.gaze[rows].clone(), data.towards[rows].clone()
    patches = data.patches[rows].float() / 255.0
    count = len(rows)
    for i, (down, right) in enumerate(torch.randint(-MOVE, MOVE + 1, (count, 2)).tolist()):
        patches[i] = moved(patches[i], down, right)
    flip = torch.rand(count) < 0.5
    patches[flip] = patches[flip].flip(3)
    gaze[flip, 1] *= -1.0
    towards[flip, 0] *= -1.0
    gain = 1.0 + 0.25 * (2.0 * torch.rand(count, 1, 1, 1) - 1.0) + 0.08 * torch.randn(count, 3, 1, 1)
    power = 1.0 + 0.3 * (2.0 * torch.rand(count, 1, 1, 1) - 1.0)
    patches = patches.clamp(min=1e-4) ** power * gain
    return (patches + 0.01 * torch.randn_like(patches)).clamp(0.0, 1.0), gaze, towards


def moved(patch: torch.Tensor, down: int, right: int) -> torch.Tensor:
    """A picture (3, H, W) moved by whole pixels, black where nothing comes from."""
    height, width = patch.shape[-2:]
    out = torch.zeros_like(patch)
    rows, columns = slice(max(0, down), height + min(0, down)), slice(max(0, right), width + min(0, right))
    from_rows = slice(max(0, -down), height + min(0, -down))
    from_columns = slice(max(0, -right), width + min(0, -right))
    out[:, rows, columns] = patch[:, from_rows, from_columns]
    return out


def pose_errors(estimator: PoseEstimator, data: PoseData, device: torch.device, batch: int = 64) -> dict[str, Any]:
    """`error_summary` of the gaze, and under `head` that of the direction to the camera."""
    estimator.eval()
    gaze, head = [], []
    with torch.no_grad():
        for first in range(0, len(data), batch):
            rows = slice(first, first + batch)
            pose = estimator(data.patches[rows].to(device).float() / 255.0)
            gaze.append(angular_error(gaze_vectors(pose.gaze.cpu()), gaze_vectors(data.gaze[rows])))
            head.append(angular_error(gaze_vectors(pose.head.cpu()), data.towards[rows]))
    of_gaze, of_head = (torch.rad2deg(torch.cat(found)).numpy() for found in (gaze, head))
    return {**error_summary(of_gaze), "head": error_summary(of_head)}
