"""Pictures of a data set with arrows along their labels, so that an eye can see whether the signs are understood."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from gazenerf.datasets.choosing import chosen_subjects
from gazenerf.datasets.options import PrepareOptions
from gazenerf.datasets.published import Listed, PublishedSet, Sample
from gazenerf.errors import UserError
from gazenerf.files import whole_file

GAZE, HEAD = (255, 214, 10), (90, 200, 250)
TILE, COLUMNS, MOST = 256, 4, 12
CAPTION = 34
"""Pixels below each picture."""


def write_arrows(found: PublishedSet, options: PrepareOptions, path: Path) -> int:
    """Write up to `MOST` pictures of the chosen subjects with arrows.

    Args:
        found: The data set.
        options: Which subjects.
        path: PNG, JPEG or WebP.

    Returns:
        How many pictures are shown.

    Raises:
        UserError: no picture can be read, or the file cannot be written.
    """
    chosen = chosen_subjects(found, options.subjects, options.people)
    each = max(1, MOST // len(chosen))
    tiles: list[np.ndarray] = []
    for _, subject in chosen[:MOST]:
        with found.open(subject) as opened:
            usable = [item for item in opened.listed if item.fault is None]
            for item in usable[:: max(1, len(usable) // each)][:each]:
                tiles.append(arrow_tile(f"{subject} {item.name}", item, opened.read(item.number)))
    if not tiles:
        raise UserError("no picture has a label that could be shown")
    with whole_file(path) as temporary:
        Image.fromarray(sheet(tiles)).save(temporary)
    return len(tiles)


def arrow_tile(title: str, item: Listed, sample: Sample) -> np.ndarray:
    """(TILE + CAPTION, TILE, 3) uint8: a picture with yellow along its gaze label and blue along the head pose."""
    tile = np.zeros((TILE + CAPTION, TILE, 3), np.uint8)
    height, width = sample.pixels.shape[:2]
    side = min(height, width)
    top, left = (height - side) // 2, (width - side) // 2
    square = sample.pixels[top : top + side, left : left + side]
    tile[:TILE] = cv2.resize(square, (TILE, TILE), interpolation=cv2.INTER_AREA)
    middle = np.array([TILE / 2, TILE / 2])
    if sample.head is not None:
        _arrow(tile, middle + np.array([0.0, 14.0]), sample.head @ np.array([0.0, 0.0, 1.0]), HEAD)
    _arrow(tile, middle, sample.direction, GAZE)
    drawing, font = (image := Image.fromarray(tile)), ImageFont.load_default(12)
    draw = ImageDraw.Draw(drawing)
    draw.text((4, TILE + 2), title, fill=(255, 255, 255), font=font)
    draw.text((4, TILE + 17), said(sample.direction), fill=GAZE, font=font)
    return np.array(image)


def said(direction: np.ndarray) -> str:
    """A direction (3,) in camera axes in words of the picture."""
    x, y, z = direction
    up, right = np.rad2deg(np.arcsin(np.clip(-y, -1, 1))), np.rad2deg(np.arctan2(x, -z))
    vertical = f"{abs(up):.0f} {'up' if up >= 0 else 'down'}"
    return f"looks {vertical}, {abs(right):.0f} to the {'right' if right >= 0 else 'left'} of the picture"


def sheet(tiles: list[np.ndarray], columns: int = COLUMNS) -> np.ndarray:
    """Tiles of one size in rows."""
    height, width = tiles[0].shape[:2]
    rows = -(-len(tiles) // columns)
    out = np.zeros((rows * height, min(columns, len(tiles)) * width, 3), np.uint8)
    for i, tile in enumerate(tiles):
        row, column = divmod(i, columns)
        out[row * height : (row + 1) * height, column * width : (column + 1) * width] = tile
    return out


def _arrow(image: np.ndarray, start: np.ndarray, direction: np.ndarray, colour: tuple[int, int, int]) -> None:
    end = start + 0.45 * TILE * direction[:2]
    first, last = (tuple(int(v) for v in np.round(point * 16)) for point in (start, end))
    for width, shade in ((5, (0, 0, 0)), (2, colour)):
        cv2.arrowedLine(image, first, last, shade, width, cv2.LINE_AA, 4, 0.2)
