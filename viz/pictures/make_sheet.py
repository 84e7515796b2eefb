"""A sheet from its options: gazes and cameras planned, drawn and written as one picture."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from gazenerf.errors import UserError
from gazenerf.files import refuse_existing, whole_file
from gazenerf.geometry import Camera, Gaze
from gazenerf.geometry.camera_options import CAMERA, CameraOptions
from gazenerf.geometry.paths import EYE_MIDPOINT, GazeRange
from gazenerf.head_model import ReferenceHead
from gazenerf.heads.backgrounds import BackgroundOptions
from gazenerf.heads.interface import HeadField
from gazenerf.options import option
from gazenerf.progress import Progress, silent
from gazenerf.viz.pictures.sheets import contact_sheet, gaze_grid

KINDS = ("gaze-grid", "contact")

CROPS: dict[str, tuple[float, float, float, float] | None] = {
    "whole": None,
    "face": (-0.95, 0.95, -1.05, 0.7),
    "eyes": (-0.75, 0.75, -0.25, 0.3),
}
"""Left, right, lower and upper border in world units from the middle between the eyes."""

OPAQUE = (".jpg", ".jpeg")
SUFFIXES = (".png", *OPAQUE, ".webp")


@dataclass(frozen=True, kw_only=True)
class SheetOptions(BackgroundOptions, CameraOptions):
    """What a sheet shows; angles in degrees.

    Attributes:
        kind: gaze-grid: pitch down, gaze yaw across, one camera; contact: gazes down, camera yaw across.
        pitches, yaws: Gaze pitches and yaws of the grid; spread over the trained range by default.
        gaze: (pitch, yaw) of the rows of the contact sheet.
        views: Camera yaws of the contact sheet.
        crop: What the grid's tiles keep, a name of `CROPS`.
        yaw, pitch: Of the camera.
    """

    kind: str = option(
        "gaze-grid",
        "gaze-grid: pitch down, gaze yaw across, one camera; contact: gazes down, camera yaw across",
        choices=KINDS,
    )
    pitches: tuple[float, ...] = option((), "gaze pitches of the grid", metavar="DEG")
    yaws: tuple[float, ...] = option((), "gaze yaws of the grid", metavar="DEG")
    gaze: tuple[tuple[float, float], ...] = option(
        (), "a row of the contact sheet; repeat it", metavar=("PITCH", "YAW")
    )
    views: tuple[float, ...] = option(
        (-60.0, -30.0, 0.0, 30.0, 60.0), "camera yaws of the contact sheet", metavar="DEG"
    )
    crop: str = option("face", "what the grid's tiles keep (default: face)", choices=tuple(CROPS))
    yaw: float = option(0.0, "camera yaw of the grid", metavar="DEG", group=CAMERA)
    pitch: float = option(0.0, "camera pitch", metavar="DEG", group=CAMERA)


@dataclass(frozen=True)
class SheetResult:
    """A sheet that was written.

    Attributes:
        file: The picture.
        width, height: Pixels.
        tiles: How many.
        seconds: Wall time.
    """

    file: Path
    width: int
    height: int
    tiles: int
    seconds: float


def check_sheet(out: Path, options: SheetOptions, overwrite: bool = False) -> None:
    """Raise UserError for what cannot be made whoever is drawn, or is there already."""
    options.check_camera()
    if out.suffix.lower() not in SUFFIXES:
        raise UserError(f"cannot write a sheet as {out.name}; name --out .png, .jpg or .webp")
    background = options.chosen_background()
    if background is not None and background.colour is None and out.suffix.lower() in OPAQUE:
        raise UserError(f"{out.name}: JPEG holds no transparency; name --out .png or .webp, or --background a colour")
    refuse_existing([out], overwrite)
    angles = [*options.pitches, *options.yaws, *options.views, options.yaw, options.pitch, *np.ravel(options.gaze)]
    if not np.isfinite(angles).all():
        raise UserError("angles must be finite numbers of degrees")


def sheet_gazes(options: SheetOptions, limits: GazeRange | None) -> list[list[Gaze]]:
    """The gazes of a sheet: the grid's rows from the top, or a row for each gaze of the contact sheet."""
    limits = limits or GazeRange()
    if options.kind == "contact":
        corner = 0.7 * limits.pitch, 0.7 * limits.yaw
        signs = ((0, 0), (0, 1), (0, -1), (1, 0), (-1, 0))
        gazes = [Gaze.from_degrees(*angles) for angles in options.gaze]
        return [[gaze] for gaze in gazes or [Gaze(p * corner[0], y * corner[1]) for p, y in signs]]
    pitches = np.deg2rad(options.pitches) if options.pitches else _round_end(limits.pitch) * np.linspace(-1, 1, 3)
    yaws = np.deg2rad(options.yaws) if options.yaws else _round_end(limits.yaw) * np.linspace(-1, 1, 5)
    return [[Gaze(float(pitch), float(yaw)) for yaw in yaws] for pitch in pitches]


def make_sheet(
    head: HeadField, out: str | Path, options: SheetOptions, *, overwrite: bool = False, progress: Progress = silent
) -> SheetResult:
    """Draw a sheet and write it.

    Args:
        head: Who is drawn.
        out: A .png, .jpg or .webp picture.
        options: What is shown.
        overwrite: Replace what is there.
        progress: Told about tiles.

    Raises:
        UserError: see `check_sheet`; also eyes outside the picture.
    """
    out = Path(out)
    check_sheet(out, options, overwrite)
    rows = sheet_gazes(options, head.trained_range)
    cameras = [options.orbiting(yaw, options.pitch) for yaw in options.views]
    front = options.orbiting(options.yaw, options.pitch)
    background = options.chosen_background()
    started = time.perf_counter()
    if options.kind == "contact":
        picture = contact_sheet(head, cameras, [row[0] for row in rows], background=background, progress=progress)
        tiles = len(rows) * len(cameras)
    else:
        reference = ReferenceHead.of(head.subject)
        eyes = np.asarray(EYE_MIDPOINT) if reference is None else reference.eye_midpoint()
        crop = crop_box(front, eyes, CROPS[options.crop])
        pitches, yaws = [row[0].pitch for row in rows], [gaze.yaw for gaze in rows[0]]
        picture = gaze_grid(head, front, pitches, yaws, crop=crop, background=background, progress=progress)
        tiles = len(pitches) * len(yaws)
    with whole_file(out) as temporary:
        Image.fromarray(picture).save(temporary, quality=92)
    return SheetResult(out, picture.shape[1], picture.shape[0], tiles, time.perf_counter() - started)


def _round_end(limit: float) -> float:
    """The last multiple of 5 degrees safely inside a range, radians; most of the range where it is narrow."""
    degrees = 5.0 * np.floor(0.95 * np.rad2deg(limit) / 5.0)
    return float(np.deg2rad(degrees)) if degrees else 0.9 * limit


def crop_box(
    camera: Camera, eyes: np.ndarray, borders: tuple[float, float, float, float] | None
) -> tuple[int, int, int, int] | None:
    """(left, top, right, bottom) pixels about the eyes, as far as the picture reaches; None for all of it.

    Args:
        camera: The camera of the tiles.
        eyes: (3,) middle between the eyes, world units.
        borders: Left, right, lower and upper border from there, world units in the picture plane.

    Raises:
        UserError: nothing is left.
    """
    if borders is None:
        return None
    (u, v), z = camera.project(np.asarray(eyes, dtype=np.float64))
    left, right = (round(float(u + camera.fx * x / z)) for x in borders[:2])
    bottom, top = (round(float(v - camera.fy * y / z)) for y in borders[2:])
    left, right, top, bottom = max(0, left), min(camera.width, right), max(0, top), min(camera.height, bottom)
    if right - left < 4 or bottom - top < 4 or z <= 0:
        raise UserError("the eyes are outside this camera's picture; change --yaw, or use --crop whole")
    return left, top, right, bottom
