"""A photograph redirected to many gazes, in one labelled picture."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from gazenerf.errors import UserError
from gazenerf.geometry import Gaze
from gazenerf.options import option
from gazenerf.photographs.redirect import Redirector, refuse_beyond
from gazenerf.progress import Progress, counted, silent
from gazenerf.viz.pictures.make_sheet import CROPS, crop_box
from gazenerf.viz.pictures.sheets import gaze_table

MOST_TILES = 400

GRID = "of a gaze grid"


@dataclass(frozen=True, kw_only=True)
class GridOptions:
    """Gazes and tiles of a grid.

    Attributes:
        pitches, yaws: Degrees, any order.
        crop: What the tiles keep, a name of `CROPS`.
        tile: Width of a tile, pixels.
    """

    pitches: tuple[float, ...] = option(
        (-12.0, 0.0, 12.0), "gaze pitches (default: -12 0 12)", metavar="DEG", group=GRID
    )
    yaws: tuple[float, ...] = option(
        (-20.0, -10.0, 0.0, 10.0, 20.0), "gaze yaws (default: -20 -10 0 10 20)", metavar="DEG", group=GRID
    )
    crop: str = option("eyes", "what the tiles keep (default: eyes)", choices=tuple(CROPS), group=GRID)
    tile: int = option(400, "width of a tile in pixels (default: 400)", metavar="PX", group=GRID)

    @property
    def requested_gazes(self) -> str:
        """The gazes that are asked for, in words."""
        pitches, yaws = (" ".join(f"{angle:g}" for angle in angles) for angles in (self.pitches, self.yaws))
        return f"requested gazes: pitches {pitches}, yaws {yaws} degrees, head frame"

    def check(self) -> None:
        """Raise UserError for what cannot be drawn."""
        if not 16 <= self.tile <= 2000 or not 0 < len(self.pitches) * len(self.yaws) <= MOST_TILES:
            raise UserError(f"a grid has tiles of 16 to 2000 pixels, 1 to {MOST_TILES} of them")
        for pitch in self.pitches:
            for yaw in self.yaws:
                refuse_beyond(Gaze.from_degrees(pitch, yaw))


def redirect_sheet(redirector: Redirector, options: GridOptions, progress: Progress = silent) -> np.ndarray:
    """(H, W, 3) uint8: rows are pitch with up on top, columns yaw with the subject's left at the right.

    Args:
        redirector: The photograph.
        options: Gazes and tiles.
        progress: Told about tiles.

    Raises:
        UserError: a gaze that cannot be drawn.
    """
    options.check()
    camera = redirector.camera
    eyes = redirector.mesh.eye_centres.mean(axis=0)
    left, top, right, bottom = crop_box(camera, eyes, CROPS[options.crop]) or (0, 0, camera.width, camera.height)
    size = options.tile, max(4, round((bottom - top) * options.tile / (right - left)))
    how = cv2.INTER_AREA if options.tile < right - left else cv2.INTER_CUBIC
    down, across = sorted(np.deg2rad(options.pitches), reverse=True), sorted(np.deg2rad(options.yaws))
    gazes = (Gaze(float(pitch), float(yaw)) for pitch in down for yaw in across)
    tiles = []
    for made in counted(map(redirector.draw, gazes), progress, "redirecting", len(down) * len(across)):
        tiles.append(cv2.resize(made.pixels[top:bottom, left:right], size, interpolation=how))
    return gaze_table(tiles, down, across)
