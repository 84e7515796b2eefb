"""The paper's estimator for evaluation: a ResNet50 that reads gaze and head pose off a patch of the face (Sec. 4.2)."""

from __future__ import annotations

import json
import pickle
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import torch
from safetensors.torch import save_file
from torch import nn

from gazenerf.archives import open_archive
from gazenerf.errors import UserError
from gazenerf.files import check_name, parse_json, whole_file
from gazenerf.geometry import Camera
from gazenerf.pickles import TensorRecord
from gazenerf.tensor_files import TensorFileKind, open_tensors
from gazenerf.training.face_patch import face_patch
from gazenerf.training.losses import gaze_vectors
from gazenerf.training.perceptual import IMAGENET_MEAN, IMAGENET_STD
from gazenerf.training.resnet import FEATURES, RESNET50, ResNet

FORMAT = "gazenerf-pose-estimator-1"
MAX_BYTES, MOST_BLOCKS = 256 * 2**20, 64
TRAIN = "train one with `gazenerf train-estimator`"
KIND = TensorFileKind("pose estimator", FORMAT, MAX_BYTES, absent=TRAIN, foreign=TRAIN)

PUBLISHED = "gaze_fc."
"""How a weight of the published estimator's last layer begins."""


class Pose(NamedTuple):
    """What the network says about patches.

    Attributes:
        gaze: (B, 2) pitch, yaw in radians.
        head: (B, 2) pitch, yaw of the direction from the head to the camera, as of a gaze.
    """

    gaze: torch.Tensor
    head: torch.Tensor


class PoseEstimator(nn.Module):
    """ResNet and a linear layer with four outputs; 23.5 million parameters with the blocks of ResNet50.

    Args:
        blocks: In each stage of the ResNet.
        knows_labels: Its angles are the project's: in the head's frame, up and toward the subject's left. Those of
            published weights are their own, and patches are turned as published ones are.

    Attributes:
        about: Training data and held-out error, JSON-able.
    """

    shift: torch.Tensor
    scale: torch.Tensor

    def __init__(self, blocks: tuple[int, int, int, int] = RESNET50, knows_labels: bool = True) -> None:
        super().__init__()
        self.blocks, self.knows_labels = blocks, knows_labels
        self.about: dict[str, Any] = {}
        self.gaze_network = ResNet(blocks)
        self.gaze_fc = nn.Sequential(nn.Linear(FEATURES, 4))
        self.register_buffer("shift", torch.tensor(IMAGENET_MEAN).view(1, 3, 1, 1), persistent=False)
        self.register_buffer("scale", torch.tensor(IMAGENET_STD).view(1, 3, 1, 1), persistent=False)

    def forward(self, patches: torch.Tensor) -> Pose:
        """What the network says about patches (B, 3, 224, 224), sRGB in [0, 1]."""
        found = self.gaze_fc(self.gaze_network((patches - self.shift) / self.scale)).float()
        return Pose(found[:, :2], found[:, 2:])

    def read_views(self, images: torch.Tensor, camera: Camera) -> tuple[torch.Tensor, torch.Tensor]:
        """Gaze (B, 2) and direction to the camera (B, 3) of pictures (B, 3, H, W) from one camera; no gradients."""
        pictures = images.detach().permute(0, 2, 3, 1).numpy()
        patches = [torch.from_numpy(face_patch(picture, camera, self.knows_labels)) for picture in pictures]
        with torch.no_grad():
            pose = self(torch.stack(patches).permute(0, 3, 1, 2))
        return pose.gaze, gaze_vectors(pose.head)


def save_pose_estimator(estimator: PoseEstimator, path: str | Path) -> None:
    """Write an estimator as one safetensors file, floating-point weights as float16."""
    tensors = {
        name: (value.detach().cpu().half() if value.is_floating_point() else value.detach().cpu()).contiguous()
        for name, value in estimator.state_dict().items()
    }
    about = {"format": FORMAT, "about": json.dumps(estimator.about), "blocks": json.dumps(estimator.blocks)}
    with whole_file(path) as temporary:
        save_file(tensors, temporary, metadata=about)


def load_pose_estimator(path: str | Path) -> PoseEstimator:
    """A frozen estimator that `save_pose_estimator` wrote.

    Raises:
        UserError: missing, too large, damaged, of other shapes, or not finite.
    """
    with open_tensors(Path(path), KIND, "pt") as (file, metadata):
        a, b, c, d = (int(count) for count in parse_json(metadata["blocks"]))
        if min(a, b, c, d) < 1 or a + b + c + d > MOST_BLOCKS:
            raise ValueError(f"{a}, {b}, {c}, {d} blocks are none of a ResNet")
        about = parse_json(metadata["about"])
        weights = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
        estimator = _loaded(PoseEstimator((a, b, c, d)), weights)
    estimator.about = about
    return estimator


def import_pose_estimator(path: Path) -> PoseEstimator:
    """A frozen estimator with published weights: a ResNet50 with four outputs, saved by `torch.save`.

    Raises:
        UserError: it cannot be read, or is of another network.
    """
    weights = read_weights(path)
    weights = {name.replace(PUBLISHED, f"{PUBLISHED}0.") if _is_flat(name) else name: v for name, v in weights.items()}
    try:
        estimator = _loaded(PoseEstimator(knows_labels=False), weights)
    except (ValueError, RuntimeError) as error:
        reason = " ".join(str(error).split())[:160]
        raise UserError(
            f"{path} is no ResNet50 with four outputs, gaze and head pose ({reason}); {TRAIN}"
        ) from error  # fmt: skip
    estimator.about = {"imported_from": path.name}
    return estimator


def _is_flat(name: str) -> bool:
    return name in (f"{PUBLISHED}weight", f"{PUBLISHED}bias")


def _loaded(estimator: PoseEstimator, weights: Mapping[str, torch.Tensor]) -> PoseEstimator:
    for name, value in weights.items():
        if value.is_floating_point() and not bool(torch.isfinite(value).all()):
            raise ValueError(f"{name} holds NaN or infinite values")
    estimator.load_state_dict(dict(weights))
    return estimator.eval().requires_grad_(False)


def start_from(estimator: PoseEstimator, path: Path) -> None:
    """Give the ResNet weights of a classifier, such as torchvision's or timm's ResNet50 of ImageNet.

    Raises:
        UserError: the file cannot be read, or is of another network.
    """
    weights = {name: value for name, value in read_weights(path).items() if not name.startswith("fc.")}
    try:
        estimator.gaze_network.load_state_dict(weights)
    except RuntimeError as error:
        reason = " ".join(str(error).split())[:160]
        raise UserError(f"{path} is no ResNet50 under torchvision's names ({reason})") from error


def read_weights(path: Path) -> dict[str, torch.Tensor]:
    """The first set of named tensors in a file of `torch.save` or safetensors; nothing in it is executed.

    Raises:
        UserError: it is missing, damaged, or holds none.
    """
    check_name(path)
    if not path.is_file():
        raise UserError(f"there is no {path}; give a file of weights")
    try:
        with open_archive(path) as archive:
            records = _named_tensors(archive.content)
            return {name.removeprefix("module."): archive.tensor(record) for name, record in records.items()}
    except (pickle.UnpicklingError, zipfile.BadZipFile, LookupError, ValueError, TypeError, OSError) as error:
        raise UserError(f"cannot read the weights {path}: {error}; nothing in it was executed") from error


def _named_tensors(content: Any) -> dict[str, TensorRecord]:
    level = [content]
    for _ in range(3):
        for entry in level:
            if isinstance(entry, dict):
                found = {str(name): value for name, value in entry.items() if isinstance(value, TensorRecord)}
                if found:
                    return found
        level = [value for entry in level if isinstance(entry, dict) for value in entry.values()]
    raise ValueError("it holds no named tensors")
