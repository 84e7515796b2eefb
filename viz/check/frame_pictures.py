"""Pictures and depth maps that others wrote, read as they mean: sizes are checked before anything is unpacked."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
from PIL import ExifTags, Image, ImageOps, UnidentifiedImageError

from gazenerf.errors import UserError

MAX_FILE_BYTES = 128 * 2**20
MAX_PIXELS = 64 * 10**6

FORMATS = ("PNG", "JPEG", "WEBP")
DEEP = ("I", "I;16", "I;16B", "I;16L")
"""Modes of pictures of one channel of 16 bits."""

SIDEWAYS = (5, 6, 7, 8)
"""EXIF orientations that exchange width and height."""


def picture_size(file: Path) -> tuple[int, int]:
    """Width and height of the picture as it is stored, by the file's header.

    Raises:
        UserError: no picture that is read here, or too large a one.
    """
    try:
        if file.stat().st_size > MAX_FILE_BYTES:
            raise UserError(f"{file} is larger than {MAX_FILE_BYTES >> 20} MiB")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            with Image.open(file, formats=FORMATS) as image:
                size = image.size
    except (OSError, Image.DecompressionBombError, UnidentifiedImageError, ValueError, SyntaxError) as error:
        raise UserError(f"{file} is no readable {', '.join(FORMATS)} picture") from error
    if size[0] * size[1] > MAX_PIXELS or min(size) < 16:
        raise UserError(
            f"{file} is {size[0]}x{size[1]}; pictures of 16 pixels to {MAX_PIXELS // 10**6} megapixels are read"
        )
    return size


def turned(file: Path) -> int:
    """The EXIF orientation of a picture, 1 where it is upright or says nothing."""
    try:
        with Image.open(file, formats=FORMATS) as image:
            found = image.getexif().get(ExifTags.Base.Orientation, 1)
    except (OSError, ValueError, SyntaxError) as error:
        raise UserError(f"{file} cannot be read: {str(error)[:120]}") from error
    return found if isinstance(found, int) and 1 <= found <= 8 else 1


def read_picture(file: Path, upright: bool = False) -> np.ndarray:
    """(H, W, 3) uint8 sRGB of a picture in any mode: grey of 16 bits is scaled, transparency laid on white.

    Args:
        file: PNG, JPEG or WebP.
        upright: Turn it as its EXIF orientation says.

    Raises:
        UserError: it cannot be read.
    """
    try:
        with Image.open(file, formats=FORMATS) as opened:
            image = ImageOps.exif_transpose(opened) if upright else opened
            if image.mode in DEEP:
                grey = np.clip(np.asarray(image, dtype=np.float64) / 257.0, 0.0, 255.0)
                return np.repeat(np.round(grey).astype(np.uint8)[..., None], 3, axis=-1)
            if "A" in image.getbands() or "transparency" in image.info:
                image = image.convert("RGBA")
                image = Image.alpha_composite(Image.new("RGBA", image.size, "white"), image)
            return np.array(image.convert("RGB"))
    except (OSError, ValueError, SyntaxError) as error:
        raise UserError(f"{file} cannot be read: {str(error)[:120]}") from error


def read_depth(file: Path, shape: tuple[int, int]) -> np.ndarray | None:
    """(H, W) float32 as it is stored, of a 16-bit picture or an .npy array; None where the file is of no use.

    Pictures of 8 bits, in colour or with a palette show depth to people; they hold no distances.
    """
    try:
        if not file.is_file() or file.stat().st_size > MAX_FILE_BYTES:
            return None
        if file.suffix.lower() == ".npy":
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
