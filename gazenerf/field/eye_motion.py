"""How the eyes turn: strategies by name."""

from __future__ import annotations

from collections.abc import Callable

import torch


def gaze_rotation(label: torch.Tensor) -> torch.Tensor:
    """The published rotation Ry(yaw) Rx(pitch) of labels (..., 2) = (pitch, yaw): (..., 3, 3)."""
    pitch, yaw = label[..., 0], label[..., 1]
    sp, cp, sy, cy = pitch.sin(), pitch.cos(), yaw.sin(), yaw.cos()
    zero = torch.zeros_like(sp)
    rows = [
        torch.stack([cy, sy * sp, sy * cp], dim=-1),
        torch.stack([zero, cp, -sp], dim=-1),
        torch.stack([-sy, cy * sp, cy * cp], dim=-1),
    ]
    return torch.stack(rows, dim=-2)


def rotate_features(features: torch.Tensor, label: torch.Tensor) -> torch.Tensor:
    """Rotate features in groups of three (paper Sec. 3.2, "3D awareness").

    Channel 3k + j is component j of group k; each row vector v becomes v R, in float32 whatever autocast says.

    Args:
        features: (..., C), C a multiple of 3.
        label: (..., 2) the streams' gaze label, broadcast over leading dimensions.
    """
    with torch.autocast(features.device.type, enabled=False):
        rotation = gaze_rotation(label.float())
        groups = features.float().unflatten(-1, (-1, 3))
        if rotation.dim() == groups.dim() and rotation.shape[-3] == 1:  # one product a picture, not one a feature
            turned = groups.flatten(-3, -2) @ rotation.squeeze(-3)
            return turned.unflatten(-2, groups.shape[-3:-1]).flatten(-2)
        return (groups @ rotation).flatten(-2)


def keep_features(features: torch.Tensor, label: torch.Tensor) -> torch.Tensor:
    """No explicit motion: the streams see the gaze as an input only."""
    return features


EYE_MOTIONS: dict[str, Callable[[torch.Tensor, torch.Tensor], torch.Tensor]] = {
    "feature_rotation": rotate_features,
    "none": keep_features,
}
