"""`gazenerf sheet`: many gazes or views of one head in one labelled picture."""

from __future__ import annotations

import argparse
import time

import numpy as np

from gazenerf.errors import UserError
from gazenerf.files import whole_file
from gazenerf.geometry import Camera, Gaze
from gazenerf.geometry.paths import GazeRange

HELP = "put many gazes or views of a head into one labelled picture"

KINDS = ("gaze-grid", "contact")

CROPS: dict[str, tuple[float, float, float, float] | None] = {
    "whole": None,
    "face": (-0.95, 0.95, -1.05, 0.7),
    "eyes": (-0.75, 0.75, -0.25, 0.3),
}
"""Left, right, lower and upper border in world units from the middle between the eyes."""


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    from gazenerf.cli.views import add_camera_arguments, add_scene_arguments

    add_scene_arguments(parser, ".png, .jpg or .webp picture")
    parser.add_argument(
        "--kind",
        choices=KINDS,
        default="gaze-grid",
        help="gaze-grid: pitch down, gaze yaw across, one camera; contact: gazes down, camera yaw across",
    )
    parser.add_argument("--pitches", nargs="+", type=float, metavar="DEG", help="gaze pitches of the grid")
    parser.add_argument("--yaws", nargs="+", type=float, metavar="DEG", help="gaze yaws of the grid")
    parser.add_argument(
        "--gaze",
        nargs=2,
        type=float,
        action="append",
        default=[],
        metavar=("PITCH", "YAW"),
        help="a row of the contact sheet; repeat it",
    )
    parser.add_argument(
        "--views",
        nargs="+",
        type=float,
        default=[-60, -30, 0, 30, 60],
        metavar="DEG",
        help="camera yaws of the contact sheet",
    )
    parser.add_argument(
        "--crop", choices=tuple(CROPS), default="face", help="what the grid's tiles keep (default: face)"
    )
    camera = add_camera_arguments(parser)
    camera.add_argument("--yaw", type=float, default=0.0, metavar="DEG", help="camera yaw of the grid")
    camera.add_argument("--pitch", type=float, default=0.0, metavar="DEG", help="camera pitch")


def run(args: argparse.Namespace) -> int:
    """Render the tiles, write the picture, and print what was written."""
    from PIL import Image

    from gazenerf.cli.common import progress
    from gazenerf.cli.views import (
        beyond_training,
        binder,
        check_camera_arguments,
        eye_midpoint,
        gaze_limits,
        load_scene,
        refuse_existing,
        say,
        warn,
    )
    from gazenerf.viz.pictures.sheets import contact_sheet, gaze_grid

    check_camera_arguments(args)
    if args.out.suffix.lower() not in (".png", ".jpg", ".jpeg", ".webp"):
        raise UserError(f"cannot write a sheet as {args.out.name}; name --out .png, .jpg or .webp")
    refuse_existing(args.out, args.overwrite)
    field, subject = load_scene(args)
    pitches, yaws, gazes = plan_gazes(args, gaze_limits(field))
    shown = gazes if args.kind == "contact" else [Gaze(pitch, yaw) for pitch in pitches for yaw in yaws]
    if note := beyond_training(field, shown):
        warn(note)

    bind = binder(field, subject)

    def camera(yaw: float) -> Camera:
        try:
            where = float(np.deg2rad(yaw)), float(np.deg2rad(args.pitch))
            return Camera.orbit(*where, distance=args.distance, size=args.size, fov=float(np.deg2rad(args.fov)))
        except ValueError as error:
            raise UserError(f"cannot place the camera: {error}; change --pitch") from error

    cameras = [camera(yaw) for yaw in args.views]
    started = time.perf_counter()
    tiles = len(shown) * (len(cameras) if args.kind == "contact" else 1)
    with progress("rendering", tiles) as advance:
        if args.kind == "contact":
            picture = contact_sheet(bind, cameras, gazes, done=advance)
        else:
            front = camera(args.yaw)
            crop = crop_box(front, eye_midpoint(subject), CROPS[args.crop])
            picture = gaze_grid(bind, front, pitches, yaws, crop=crop, done=advance)
    with whole_file(args.out) as temporary:
        Image.fromarray(picture).save(temporary, quality=92)
    seconds = time.perf_counter() - started
    say(
        f"{args.kind} of {subject.name}",
        {
            "picture": args.out,
            "size": f"{picture.shape[1]}x{picture.shape[0]}, {tiles} tiles",
            "rendered in": f"{seconds:.1f} s, {tiles / seconds:.2f} tiles/s",
        },
    )
    return 0


def plan_gazes(args: argparse.Namespace, limits: GazeRange) -> tuple[list[float], list[float], list[Gaze]]:
    """Pitches and yaws of the grid, radians, and gazes of the contact sheet; spread over the range by default.

    Raises:
        UserError: an angle is not finite.
    """
    pitches = np.deg2rad(args.pitches) if args.pitches else _round_end(limits.pitch) * np.linspace(-1, 1, 3)
    yaws = np.deg2rad(args.yaws) if args.yaws else _round_end(limits.yaw) * np.linspace(-1, 1, 5)
    corner = 0.7 * limits.pitch, 0.7 * limits.yaw
    signs = ((0, 0), (0, 1), (0, -1), (1, 0), (-1, 0))
    gazes = [Gaze.from_degrees(*angles) for angles in args.gaze]
    gazes = gazes or [Gaze(p * corner[0], y * corner[1]) for p, y in signs]
    if not np.isfinite([*pitches, *yaws, *args.views, args.yaw, args.pitch, *np.ravel(args.gaze)]).all():
        raise UserError("angles must be finite numbers of degrees")
    return [float(p) for p in pitches], [float(y) for y in yaws], gazes


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
