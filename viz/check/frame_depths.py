"""Depth maps that others wrote, read as they mean; pictures are read by `gazenerf.photographs.picture`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from gazenerf.errors import UserError
from gazenerf.files import reading_numpy
from gazenerf.photographs.picture import DEEP, MAX_FILE_BYTES, picture_size


def read_depth(file: Path, shape: tuple[int, int]) -> np.ndarray | None:
    """(H, W) float32 as it is stored, of a 16-bit picture or an .npy array; None where the file is of no use.

    Pictures of 8 bits, in colour or with a palette show depth to people; they hold no distances.
    """
    try:
        if not file.is_file() or file.stat().st_size > MAX_FILE_BYTES:
            return None
        if file.suffix.lower() == ".npy":
            with reading_numpy():
                stored = np.load(file, mmap_mode="r", allow_pickle=False)
            if stored.dtype.kind not in "fui" or stored.shape not in (shape, (*shape, 1)):
                return None
            return np.array(stored, dtype=np.float32).reshape(shape)
        if picture_size(file) != shape[::-1]:
            return None
        with Image.open(file, formats=("PNG",)) as image:
            return np.array(image, dtype=np.float32) if image.mode in DEEP else None
    except (OSError, ValueError, SyntaxError, UserError):
        return None
