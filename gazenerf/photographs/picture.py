"""Pictures that others made, read as they mean: sizes are checked before anything is unpacked."""

from __future__ import annotations

import io
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import ExifTags, Image, ImageCms, ImageOps, UnidentifiedImageError

from gazenerf.errors import UserError

MAX_FILE_BYTES = 128 * 2**20
MAX_PIXELS = 64 * 10**6

FORMATS = ("PNG", "JPEG", "WEBP")
DEEP = ("I", "I;16", "I;16B", "I;16L")
"""Modes of pictures of one channel of 16 bits."""

SIDEWAYS = (5, 6, 7, 8)
"""EXIF orientations that exchange width and height."""

MAX_PROFILE_BYTES = 4 * 2**20


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


def read_picture(file: Path, told: tuple[object, object] = (None, None)) -> Picture:
    """A picture in any mode: grey of 16 bits is scaled, transparency laid on white, colour profiles applied.

    It is turned as its EXIF orientation says, unless its camera speaks of the width and height that are stored.

    Args:
        file: PNG, JPEG or WebP, of a size that `picture_size` lets pass.
        told: Width and height that its camera speaks of; anything else where it does not.

    Raises:
        UserError: it cannot be read.
    """
    try:
        with _opened(file) as opened:
            orientation = opened.getexif().get(ExifTags.Base.Orientation, 1)
            known = orientation in range(2, 9)
            kept = known and orientation in SIDEWAYS and opened.width != opened.height and told == opened.size
            turned = known and not kept
            image = ImageOps.exif_transpose(opened) if turned else opened
            return Picture(_srgb(image), turned, kept)
    except (OSError, ValueError, SyntaxError) as error:
        raise UserError(f"{file} cannot be read: {str(error)[:120]}") from error


def read_photograph(file: Path) -> np.ndarray:
    """(H, W, 3) uint8 sRGB: a photograph, upright as its EXIF orientation says.

    Raises:
        UserError: missing, no picture that is read here, cut short, or not of 16 pixels to 64 megapixels.
    """
    if not file.is_file():
        raise UserError(f"{file} does not exist; give a photograph ({', '.join(FORMATS)})")
    picture_size(file)
    return read_picture(file).pixels


def read_grey(file: Path, *, indices: bool = False) -> np.ndarray:
    """(H, W) uint8: a mask or label image; its EXIF orientation is not looked at.

    Args:
        file: PNG, JPEG or WebP.
        indices: A palette picture gives its indices, as face parsers write labels.

    Raises:
        UserError: as `read_photograph`.
    """
    if not file.is_file():
        raise UserError(f"{file} does not exist; give a {', '.join(FORMATS)} picture")
    picture_size(file)
    try:
        with _opened(file) as image:
            if image.mode == "1" or (indices and image.mode in ("P", "L")):
                return np.array(image.convert("L") if image.mode == "1" else image, dtype=np.uint8)
            return np.array(Image.fromarray(_srgb(image)).convert("L"))
    except (OSError, ValueError, SyntaxError) as error:
        raise UserError(f"{file} cannot be read: {str(error)[:120]}") from error


def _opened(file: Path) -> Image.Image:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", Image.DecompressionBombWarning)
        return Image.open(file, formats=FORMATS)


def _srgb(image: Image.Image) -> np.ndarray:
    if image.mode in DEEP:
        grey = np.clip(np.asarray(image, dtype=np.float64) / 257.0, 0.0, 255.0)
        return np.repeat(np.round(grey).astype(np.uint8)[..., None], 3, axis=-1)
    if "A" in image.getbands() or "transparency" in image.info:
        image = image.convert("RGBA")
        image = Image.alpha_composite(Image.new("RGBA", image.size, "white"), image)
    return np.array(_by_profile(image).convert("RGB"))


def _by_profile(image: Image.Image) -> Image.Image:
    """The picture in sRGB by its embedded colour profile; as it is where there is none, or none that fits."""
    profile = image.info.get("icc_profile")
    if image.mode not in ("RGB", "CMYK") or not profile or len(profile) > MAX_PROFILE_BYTES:
        return image
    try:
        source = ImageCms.ImageCmsProfile(io.BytesIO(profile))
        return ImageCms.profileToProfile(image, source, ImageCms.createProfile("sRGB"), outputMode="RGB") or image
    except (ImageCms.PyCMSError, OSError, ValueError, TypeError):
        return image
