"""What a field's pictures lack of a skin's colour: freckles, stubble, the hairs of brows, split into bands by size."""

from __future__ import annotations

import cv2
import numpy as np
import torch

from gazenerf.field.detail import DARK, EXTENT, SurfaceDetail, TextureDetail
from gazenerf.head_model.shading import linear_to_srgb

BANDS, GAINS = (0.0, 0.625, 1.25, 2.5, 5.0, 10.0), (1.0, 1.0, 0.5, 0.0, 0.1)
"""Degrees: deviations of Gaussians between which bands of detail lie; and how much of each band is drawn.

By least squares, over pictures of 50 people, `portrait-sdf` lacked 0.1, 1.1, 0.35, 0.0 and 0.1 of them: the rest it
draws itself. The finest band does not lie where it should to a millimetre, so that least squares would leave it out;
drawn all the same, pictures look more alike (LPIPS 0.074 with 0.6 of it, 0.064 with all).
"""

BRIGHTEST = 0.1
"""Most that is drawn: between the dark hairs of a beard that the streams miss, more would be white specks."""


def skin_detail(skin: TextureDetail, texture: torch.Tensor) -> SurfaceDetail:
    """The detail of a texture code (T,): logarithms of colour ratios.

    A picture whose sRGB is c becomes (c + `DARK`) exp(values) - `DARK`, in any light.
    """
    with torch.no_grad():
        values = drawn_bands(logarithm(skin.albedo(texture).cpu().numpy())) * skin.share.cpu().numpy()
    return SurfaceDetail(torch.from_numpy(values).to(texture.device)).requires_grad_(False)


def logarithm(albedo: np.ndarray) -> np.ndarray:
    """Of sRGB colours in white light, `DARK` added, of linear RGB (...)."""
    return np.log(linear_to_srgb(albedo) + DARK).astype(np.float32)


def drawn_bands(maps: np.ndarray) -> np.ndarray:
    """What is drawn of maps (3, H, W) over directions: their bands by `GAINS`, no brighter than `BRIGHTEST`."""
    cell = 2.0 * EXTENT[0] / maps.shape[2]
    values = np.ascontiguousarray(maps.transpose(1, 2, 0))
    smooth = [values if size == 0.0 else cv2.GaussianBlur(values, (0, 0), size / cell) for size in BANDS]
    found = sum(gain * (fine - coarse) for gain, fine, coarse in zip(GAINS, smooth[:-1], smooth[1:], strict=True))
    found = np.minimum(found, BRIGHTEST)
    return np.ascontiguousarray(found.transpose(2, 0, 1), np.float32)
