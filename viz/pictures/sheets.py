"""Many gazes or views of one head in one labelled picture."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from gazenerf.errors import UserError
from gazenerf.geometry import Camera, Gaze
from gazenerf.heads.backgrounds import Background
from gazenerf.heads.cutouts import render_cut_out
from gazenerf.heads.interface import BoundField, HeadField
from gazenerf.progress import Progress, counted, silent
from gazenerf.viz.pictures.colormaps import to_uint8
from gazenerf.viz.pictures.drawing import draw_views
from gazenerf.viz.pictures.layout import table


def gaze_grid(
    head: HeadField,
    camera: Camera,
    pitches: Sequence[float] | np.ndarray,
    yaws: Sequence[float] | np.ndarray,
    *,
    crop: tuple[int, int, int, int] | None = None,
    background: Background | None = None,
    progress: Progress = silent,
) -> np.ndarray:
    """One camera, many gazes: rows are pitch with up on top, columns yaw with the subject's left at the right.

    So the eyes of a tile look toward where the tile lies in the grid, as a viewer sees it.

    Args:
        head: Who is drawn.
        camera: Its size is the size of a tile.
        pitches: Radians, any order.
        yaws: Radians, any order.
        crop: (left, top, right, bottom) pixels of every tile to keep.
        background: Behind the heads and the table instead of the field's own.
        progress: Told about tiles.

    Returns:
        (H, W, 3) uint8; (H, W, 4) where there is nothing behind.

    Raises:
        UserError: no pitches or no yaws.
    """
    if len(pitches) == 0 or len(yaws) == 0:
        raise UserError("a gaze grid needs at least one pitch and one yaw")
    down, across = sorted(pitches, reverse=True), sorted(yaws)
    left, top, right, bottom = crop or (0, 0, camera.width, camera.height)
    gazes = [Gaze(float(pitch), float(yaw)) for pitch in down for yaw in across]
    tiles = _drawn(head, [(camera, gaze) for gaze in gazes], background, progress)
    return gaze_table([to_uint8(tile)[top:bottom, left:right] for tile in tiles], down, across, background)


def gaze_table(
    tiles: Sequence[np.ndarray],
    down: Sequence[float],
    across: Sequence[float],
    background: Background | None = None,
) -> np.ndarray:
    """Pictures of one size at gazes, labelled.

    Args:
        tiles: (H, W, 3) uint8, row after row, or (H, W, 4) before nothing.
        down, across: Pitches of the rows and yaws of the columns, radians.
        background: Of the table; dark by default.

    Returns:
        (H', W', 3) uint8, or (H', W', 4).
    """
    rows = [tiles[first : first + len(across)] for first in range(0, len(tiles), len(across))]
    return table(
        rows, [_degrees(p) for p in down], [_degrees(y) for y in across], row_title="pitch", column_title="yaw",
        **_colours(background),
    )  # fmt: skip


def contact_sheet(
    head: HeadField,
    cameras: Sequence[Camera],
    gazes: Sequence[Gaze],
    *,
    background: Background | None = None,
    progress: Progress = silent,
) -> np.ndarray:
    """Every gaze from every camera: rows are gazes (pitch, yaw), columns the cameras' yaw about the origin.

    Args:
        head: Who is drawn.
        cameras: All of one size.
        gazes: Head frame.
        background: Behind the heads and the table instead of the field's own.
        progress: Told about tiles.

    Returns:
        (H, W, 3) uint8; (H, W, 4) where there is nothing behind.

    Raises:
        UserError: no cameras or no gazes.
    """
    if not cameras or not gazes:
        raise UserError("a contact sheet needs at least one view and one gaze")
    tiles = _drawn(head, [(camera, gaze) for gaze in gazes for camera in cameras], background, progress)
    rows = [tiles[first : first + len(cameras)] for first in range(0, len(tiles), len(cameras))]
    names = [f"{_degrees(gaze.pitch)}, {_degrees(gaze.yaw)}" for gaze in gazes]
    views = [_degrees(Gaze.from_vector(camera.position).yaw) for camera in cameras]
    titles = {"row_title": "gaze: pitch, yaw", "column_title": "camera yaw"}
    return table(rows, names, views, **titles, **_colours(background))


def _colours(background: Background | None) -> dict[str, Any]:
    return {} if background is None else {"paper": background.paper, "ink": background.ink}


def _drawn(
    head: HeadField, views: Sequence[tuple[Camera, Gaze]], background: Background | None, progress: Progress
) -> list[np.ndarray]:
    """Pictures (H, W, 3) of a head in [0, 1]; uint8, and perhaps (H, W, 4), before a background."""

    def draw(bound: BoundField, camera: Camera) -> np.ndarray:
        if background is None:
            return bound.render(camera).image
        return background.picture(render_cut_out(bound, camera).cutouts["head"])

    pictures = draw_views(head, views, draw)
    return list(counted(pictures, progress, "rendering", len(views)))


def _degrees(angle: float) -> str:
    degrees = round(float(np.rad2deg(angle)), 1)
    return f"{degrees + 0.0:+g}°" if degrees else "0°"
