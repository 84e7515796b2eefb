"""Pictures side by side, with small labels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from gazenerf.viz.pictures.colormaps import to_uint8

GAP = 4
"""Pixels between tiles."""

PAPER = (24, 24, 26)
INK = (232, 232, 232)


def grid_shape(count: int, columns: int | None = None) -> tuple[int, int]:
    """(rows, columns) for a number of tiles: one row up to three, then as square as fits."""
    if columns is None:
        columns = count if count <= 3 else int(np.ceil(count / np.floor(np.sqrt(count))))
    columns = max(1, min(columns, count))
    return -(-count // columns), columns


def grid_size(count: int, width: int, height: int, columns: int | None = None) -> tuple[int, int]:
    """(width, height) in pixels of the picture that `tile` makes of equal tiles."""
    rows, columns = grid_shape(count, columns)
    return columns * width + (columns - 1) * GAP, rows * height + (rows - 1) * GAP


def draw_label(image: np.ndarray, text: str) -> np.ndarray:
    """A copy of an (H, W, 3) or (H, W, 4) uint8 picture with a small caption on a dark plate, bottom left."""
    picture = Image.fromarray(image)
    above = Image.new("RGBA", picture.size)
    draw = ImageDraw.Draw(above)
    font = _font(image.shape[0])
    left, _, right, _ = draw.textbbox((0, 0), text, font=font)
    _, top, _, bottom = draw.textbbox((0, 0), "Ap", font=font)
    pad = max(2, image.shape[0] // 80)
    x, y = pad, image.shape[0] - pad - (bottom - top) - 2 * pad
    draw.rectangle((x, y, x + right - left + 2 * pad, y + bottom - top + 2 * pad), fill=(0, 0, 0, 150))
    draw.text((x + pad - left, y + pad - top), text, font=font, fill=(255, 255, 255, 255))
    return np.asarray(Image.alpha_composite(picture.convert("RGBA"), above).convert(picture.mode))


def tile(
    tiles: Mapping[str, np.ndarray],
    columns: int | None = None,
    labels: bool | None = None,
    paper: tuple[int, ...] = PAPER,
) -> np.ndarray:
    """Named pictures of one size in a grid, row by row.

    Args:
        tiles: Name to (H, W, 3), uint8 or sRGB in [0, 1], or to (H, W, 4) uint8.
        columns: Tiles in a row; chosen by `grid_shape` when None.
        labels: Draw the names; by default when there is more than one tile.
        paper: Colour of empty places; with an opacity where the whole picture has one.

    Returns:
        uint8 picture of `grid_size`.

    Raises:
        ValueError: no tiles, or tiles of different sizes.
    """
    pictures = {name: with_channels(to_uint8(picture), len(paper)) for name, picture in tiles.items()}
    shapes = {picture.shape for picture in pictures.values()}
    if len(shapes) != 1:
        raise ValueError(f"tiles must have one size, got {sorted(shapes)}")
    if labels if labels is not None else len(pictures) > 1:
        pictures = {name: draw_label(picture, name) for name, picture in pictures.items()}
    height, width, _ = next(iter(shapes))
    total_width, total_height = grid_size(len(pictures), width, height, columns)
    _, across = grid_shape(len(pictures), columns)
    canvas = np.full((total_height, total_width, len(paper)), paper, dtype=np.uint8)
    for index, picture in enumerate(pictures.values()):
        row, column = divmod(index, across)
        y, x = row * (height + GAP), column * (width + GAP)
        canvas[y : y + height, x : x + width] = picture
    return canvas


def table(
    rows: Sequence[Sequence[np.ndarray]],
    row_labels: Sequence[str],
    column_labels: Sequence[str],
    *,
    row_title: str = "",
    column_title: str = "",
    paper: tuple[int, ...] = PAPER,
    ink: tuple[int, ...] = INK,
) -> np.ndarray:
    """Pictures of one size in rows and columns, with labels at the left and above.

    Args:
        rows: Rows of (H, W, 3) pictures, uint8 or sRGB in [0, 1].
        row_labels: One for each row.
        column_labels: One for each column.
        row_title: What the rows are, drawn upwards at the left.
        column_title: What the columns are, drawn above.
        paper, ink: Colours of the table and its letters; with an opacity where the whole picture has one.

    Returns:
        (H', W', 3) uint8, or (H', W', 4).

    Raises:
        ValueError: labels and pictures do not match in number, or sizes differ.
    """
    if len(rows) != len(row_labels) or any(len(row) != len(column_labels) for row in rows) or not rows:
        raise ValueError("a table needs one label for each row and column")
    height, width, _ = np.asarray(rows[0][0]).shape
    mode, channels = "RGBA" if len(paper) == 4 else "RGB", len(paper)
    font = _font(height)
    line = int(font.getbbox("Ag")[3]) + 6
    measured = ImageDraw.Draw(Image.new("RGB", (1, 1)))
    margin_x = int(max(measured.textlength(label, font=font) for label in row_labels)) + 12 + (line if row_title else 0)
    margin_y = line + 4 + (line if column_title else 0)
    total_width, total_height = grid_size(len(rows) * len(column_labels), width, height, len(column_labels))
    canvas = Image.new(mode, (margin_x + total_width + GAP, margin_y + total_height + GAP), paper)
    draw = ImageDraw.Draw(canvas)
    if column_title:
        draw.text((margin_x + total_width / 2, line / 2), column_title, font=font, fill=ink, anchor="mm")
    if row_title:
        strip = Image.new(mode, (total_height, line), paper)
        ImageDraw.Draw(strip).text((total_height / 2, line / 2), row_title, font=font, fill=ink, anchor="mm")
        canvas.paste(strip.transpose(Image.Transpose.ROTATE_90), (0, margin_y))
    for j, label in enumerate(column_labels):
        x = margin_x + j * (width + GAP) + width / 2
        draw.text((x, margin_y - line / 2 - 2), label, font=font, fill=ink, anchor="mm")
    for i, (row, label) in enumerate(zip(rows, row_labels, strict=True)):
        y = margin_y + i * (height + GAP)
        draw.text((margin_x - 6, y + height / 2), label, font=font, fill=ink, anchor="rm")
        for j, picture in enumerate(row):
            pixels = with_channels(to_uint8(picture), channels)
            if pixels.shape != (height, width, channels):
                raise ValueError(f"pictures must have one size, got {pixels.shape} and {(height, width, channels)}")
            canvas.paste(Image.fromarray(pixels), (margin_x + j * (width + GAP), y))
    return np.asarray(canvas)


def with_channels(pixels: np.ndarray, channels: int) -> np.ndarray:
    """An (H, W, 3) uint8 picture with an opaque fourth channel where `channels` is 4, else the picture."""
    if channels != 4 or pixels.shape[2] == 4:
        return pixels
    return np.concatenate([pixels, np.full_like(pixels[..., :1], 255)], axis=2)


def _font(tile_height: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(size=float(np.clip(tile_height / 18, 10, 28)))
