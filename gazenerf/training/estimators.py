"""Estimators of gaze and head pose by which redirected pictures are measured."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

import torch
from safetensors import SafetensorError, safe_open

from gazenerf.checkpoints import weights_hash
from gazenerf.errors import UserError
from gazenerf.files import check_name
from gazenerf.geometry import Camera
from gazenerf.training.gaze_estimator import BUNDLED, load_gaze_estimator
from gazenerf.training.pose_estimator import FORMAT as POSE_FORMAT
from gazenerf.training.pose_estimator import import_pose_estimator, load_pose_estimator


class ViewReader(Protocol):
    """An estimator of gaze and head pose."""

    @property
    def knows_labels(self) -> bool:
        """Whether its angles are those of captures; else only two readings can be compared."""
        ...

    def read_views(self, images: torch.Tensor, camera: Camera) -> tuple[torch.Tensor, torch.Tensor]:
        """Gaze (B, 2) radians and direction from the head to the camera (B, 3), head frame.

        Args:
            images: (B, 3, H, W) sRGB in [0, 1] on black.
            camera: That took all of them.
        """
        ...


def load_view_reader(path: Path | None = None) -> ViewReader:
    """The bundled estimator, one that `gazenerf train-estimator` wrote, or published weights of a ResNet50.

    Raises:
        UserError: the file cannot be read, or is of another network.
    """
    if path is None:
        return load_gaze_estimator()
    try:
        with safe_open(_there(path), framework="pt") as file:
            kind = (file.metadata() or {}).get("format")
    except (SafetensorError, OSError):
        return import_pose_estimator(path)
    return load_pose_estimator(path) if kind == POSE_FORMAT else load_gaze_estimator(path)


def estimator_name(path: Path | None) -> str:
    """What tells which estimator an angle is of.

    Raises:
        UserError: the file is not there.
    """
    return f"{'bundled' if path is None else path.name} ({weights_hash(BUNDLED if path is None else _there(path))})"


def _there(path: Path) -> Path:
    check_name(path)
    if not path.is_file():
        raise UserError(f"no gaze estimator at {path}; train one with `gazenerf train-estimator`")
    return path
