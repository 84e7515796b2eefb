"""How the eyes turn: strategies by name.

`feature_rotation` is the paper's: the eyes stream is told the gaze, and its features are turned by it.
`none` only tells it the gaze. `rigid` is this project's: each eyeball turns about its own centre, so
the eyes stream is queried where a point of the turned eye was with the eyes straight ahead, and is
not told the gaze at all. One eye, learned once, then serves every gaze.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import torch
from torch import nn


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
    "rigid": keep_features,
}
"""What each strategy does to the features of the eyes stream; `rigid` moves points instead, see `EyePose`."""


class EyePose(NamedTuple):
    """Eyeballs turned about their centres, for B images.

    Attributes:
        centres: (B, 2, 3) centres of rotation in the world, world units.
        rotation: (B, 3, 3) takes eyes that look along +Z to eyes at the gaze.
    """

    centres: torch.Tensor
    rotation: torch.Tensor

    def straight_ahead(self, points: torch.Tensor) -> torch.Tensor:
        """Where points of the turned eyes are while the eyes look straight ahead.

        Each point turns with the eye whose centre is nearer, in float32 whatever autocast says.

        Args:
            points: (B, ..., 3) world.
        """
        shape = points.shape
        with torch.autocast(points.device.type, enabled=False):
            flat = points.reshape(shape[0], -1, 3).float()
            away = flat[:, :, None] - self.centres[:, None]
            left = (away.square().sum(-1).diff(dim=-1) > 0)[..., None]  # (B, N, 1, 1): the first centre is nearer
            centre = torch.where(left[..., 0, :], self.centres[:, None, 0], self.centres[:, None, 1])
            return (centre + (flat - centre) @ self.rotation).reshape(shape)


class EyeCentres(nn.Module):
    """Centres of rotation of a person's eyeballs, linear in the identity code, as a head model has them.

    They are constants of the field, not learned, and travel with its weights.

    Args:
        identity: Size of the identity code.
    """

    mean: torch.Tensor
    basis: torch.Tensor

    def __init__(self, identity: int) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(2, 3))
        self.register_buffer("basis", torch.zeros(identity, 2, 3))

    @torch.no_grad()
    def set(self, mean: np.ndarray, basis: np.ndarray) -> None:
        """Take a head model's centres: mean (2, 3) and what each component of the identity code adds (I, 2, 3)."""
        self.mean.copy_(torch.from_numpy(mean))
        self.basis.copy_(torch.from_numpy(basis))

    def of(self, identity: torch.Tensor) -> torch.Tensor:
        """(B, 2, 3) centres in the world, the subject's left first, of identity codes (B, I)."""
        with torch.autocast(identity.device.type, enabled=False):
            return self.mean + torch.einsum("bi,ijk->bjk", identity.float(), self.basis)

    def pose(self, identity: torch.Tensor, gaze: torch.Tensor) -> EyePose:
        """The eyes of identity codes (B, I) at gazes (B, 2) = (pitch up, yaw left), radians in the head frame."""
        upward_is_negative = torch.stack([-gaze[:, 0], gaze[:, 1]], dim=-1).float()
        return EyePose(self.of(identity), gaze_rotation(upward_is_negative))
