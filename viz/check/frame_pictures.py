"""Pictures and depth maps that others wrote, read as they mean: sizes are checked before anything is unpacked."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
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


@dataclass(frozen=True)
class Picture:
    """A picture as it was read.

    Attributes:
        pixels: (H, W, 3) uint8 sRGB.
        turned: It was turned as its EXIF orientation says.
        kept: It was not, because its camera is that of the picture as it is stored.
    """

    pixels: np.ndarray
    turned: bool
    kept: bool


def read_picture(file: Path, told: tuple[object, object]) -> Picture:
    """A picture in any mode: grey of 16 bits is scaled, transparency laid on white.

    It is turned as its EXIF orientation says, unless its camera speaks of the width and height that are stored.

    Args:
        file: PNG, JPEG or WebP, of a size that `picture_size` lets pass.
        told: Width and height that its camera speaks of; anything else where it does not.

    Raises:
        UserError: it cannot be read.
    """
    try:
        with Image.open(file, formats=FORMATS) as opened:
            orientation = opened.getexif().get(ExifTags.Base.Orientation, 1)
            known = orientation in range(2, 9)
            kept = known and orientation in SIDEWAYS and opened.width != opened.height and told == opened.size
            turned = known and not kept
            image = ImageOps.exif_transpose(opened) if turned else opened
            return Picture(_srgb(image), turned, kept)
    except (OSError, ValueError, SyntaxError) as error:
        raise UserError(f"{file} cannot be read: {str(error)[:120]}") from error


def _srgb(image: Image.Image) -> np.ndarray:
    if image.mode in DEEP:
        grey = np.clip(np.asarray(image, dtype=np.float64) / 257.0, 0.0, 255.0)
        return np.repeat(np.round(grey).astype(np.uint8)[..., None], 3, axis=-1)
    if "A" in image.getbands() or "transparency" in image.info:
        image = image.convert("RGBA")
        image = Image.alpha_composite(Image.new("RGBA", image.size, "white"), image)
    return np.array(image.convert("RGB"))


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
