"""Captures as a STED sees them, and a capture redirected by one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
import torch.nn.functional as F

from gazenerf.baselines.sted.losses import Labelled
from gazenerf.baselines.sted.network import Sted
from gazenerf.data.captures import Capture
from gazenerf.geometry import Camera, Gaze


def head_label(camera: Camera) -> np.ndarray:
    """(2,) float32 pitch and yaw, as of a gaze, of the direction from the head to a camera, head frame."""
    return Gaze.from_vector(camera.position).label


def as_picture(image: np.ndarray, size: int) -> torch.Tensor:
    """(3, size, size) float32 in [-1, 1] of a square picture (H, W, 3) uint8, averaged down or interpolated."""
    picture = torch.from_numpy(image).permute(2, 0, 1)[None].float() / 127.5 - 1.0
    return _resized(picture, size)[0]


def _resized(pictures: torch.Tensor, size: int) -> torch.Tensor:
    """(B, 3, size, size) of pictures (B, 3, S, S)."""
    if pictures.shape[-1] == size:
        return pictures
    return F.interpolate(pictures, (size, size), mode="bilinear", antialias=True, align_corners=False)


class CapturePictures:
    """Captures held in memory at a STED's size.

    Args:
        captures: Square ones.
        size: Side of the pictures.
    """

    def __init__(self, captures: Sequence[Capture], size: int) -> None:
        found = [(255.0 * (0.5 * as_picture(item.image, size) + 0.5)).round().clamp(0, 255) for item in captures]
        self._pictures = torch.stack(found).to(torch.uint8)
        self._gaze = torch.from_numpy(np.stack([item.gaze.label for item in captures]))
        self._head = torch.from_numpy(np.stack([head_label(item.camera) for item in captures]))

    def __len__(self) -> int:
        return len(self._pictures)

    def at(self, index: Sequence[int] | np.ndarray, device: torch.device) -> Labelled:
        """Those of some numbers, on a device."""
        rows = torch.as_tensor(np.asarray(index))
        pictures = self._pictures[rows].to(device).float() / 127.5 - 1.0
        return Labelled(pictures, self._gaze[rows].to(device), self._head[rows].to(device))


@torch.no_grad()
def redirect_capture(model: Sted, source: Capture, gaze: Gaze, camera: Camera) -> np.ndarray:
    """The person of a capture with another gaze, as another camera sees them.

    Only the direction to the camera is used: a STED knows how the head is turned, not where it is.

    Args:
        model: In evaluation mode.
        source: Who, in which light, before which background.
        gaze: Head frame.
        camera: Its size is ignored.

    Returns:
        (H, W, 3) float32 sRGB in [0, 1] at the source's size.
    """
    device = next(model.parameters()).device
    picture = as_picture(source.image, model.config.image_size)[None].to(device)
    labels = [torch.from_numpy(label)[None].to(device) for label in (gaze.label, head_label(camera))]
    made = _resized(model.redirect(picture, *labels), source.image.shape[0])
    return (0.5 * made[0] + 0.5).clamp(0.0, 1.0).permute(1, 2, 0).cpu().numpy()
