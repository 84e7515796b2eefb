"""Geometry in 8 and 16 bits and pictures as WebP, as KHR_mesh_quantization and EXT_texture_webp let glTF carry them."""

from __future__ import annotations

import io

import numpy as np
from PIL import Image

EXTENSIONS = ("KHR_mesh_quantization", "EXT_texture_webp")
"""What a reader must know."""

WEBP_QUALITY = 90


def signed(values: np.ndarray, dtype: str) -> np.ndarray:
    """Values (V, 3) in [-1, 1] as normalized integers (V, 4) of a little-endian type; the fourth is padding."""
    most = np.iinfo(dtype).max
    out = np.zeros((len(values), 4), dtype)
    out[:, :3] = np.round(np.clip(values, -1.0, 1.0) * most)
    return out


def unsigned(values: np.ndarray, dtype: str) -> np.ndarray:
    """Values in [0, 1] as normalized integers of a little-endian type, in the same shape."""
    return np.round(np.clip(values, 0.0, 1.0) * np.iinfo(dtype).max).astype(dtype)


def webp(png: bytes) -> bytes:
    """A PNG file as a WebP file of `WEBP_QUALITY`."""
    out = io.BytesIO()
    Image.open(io.BytesIO(png)).save(out, "WEBP", quality=WEBP_QUALITY, method=6)
    return out.getvalue()
