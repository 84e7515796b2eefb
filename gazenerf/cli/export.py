"""`gazenerf export`: pictures with their cameras, as other programs train on."""

from __future__ import annotations

import argparse
from pathlib import Path

from gazenerf.errors import UserError

HELP = "write pictures with their cameras for nerfstudio and COLMAP"

RINGS = "rings"


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    from gazenerf.cli.common import add_gaze_argument, add_source_arguments
    from gazenerf.cli.views import add_camera_arguments
    from gazenerf.geometry.paths import CAMERA_PATHS

    add_source_arguments(parser)
    add_gaze_argument(parser)
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder for pictures and cameras")
    parser.add_argument("--overwrite", action="store_true", help="replace a dataset at --out")
    parser.add_argument(
        "--layouts", nargs="+", default=["nerfstudio", "colmap"], metavar="L", help="nerfstudio, colmap (default: both)"
    )
    parser.add_argument(
        "--part", choices=("head", "face", "eyes"), default="head", help="which picture (default: head)"
    )
    parser.add_argument("--points", type=int, default=30_000, metavar="N", help="surface points (default: 30000)")
    flight = add_camera_arguments(parser)
    flight.add_argument("--frames", type=int, default=60, metavar="N", help="number of pictures (default: 60)")
    flight.add_argument(
        "--camera-path",
        default=RINGS,
        metavar="NAME",
        help=f"{RINGS} (full turns at three heights), {', '.join(CAMERA_PATHS)}, or a .json file of keyframes "
        f"(default: {RINGS})",
    )


def run(args: argparse.Namespace) -> int:
    """Render, write, report."""
    from gazenerf.cli.common import checked_gaze, load_bound_factory, progress, summary_table
    from gazenerf.export.formats.datasets import write_dataset

    gaze = checked_gaze(args.gaze)
    if args.points < 1:
        raise UserError(f"--points must be at least 1, got {args.points}")
    cameras = plan_cameras(args)
    subject, bind = load_bound_factory(args)
    with progress("rendering", total=len(cameras)) as advance:
        written = write_dataset(
            bind(gaze),
            args.out,
            cameras,
            part=args.part,
            layouts=tuple(dict.fromkeys(args.layouts)),
            points=args.points,
            overwrite=args.overwrite,
            progress=lambda done, total: advance(1),
        )
    rows = {"size": f"{len(cameras)} pictures of {args.size}x{args.size}", "units": "metres"}
    summary_table(f"dataset of {subject.name}", written | rows)
    return 0


def plan_cameras(args: argparse.Namespace) -> list:
    """The camera of every picture.

    Raises:
        UserError: arguments that make no camera.
    """
    import numpy as np

    from gazenerf.cli.views import check_camera_arguments
    from gazenerf.export.formats.datasets import rings
    from gazenerf.geometry.keyframes import keyframe_path, read_keyframes
    from gazenerf.geometry.paths import camera_path

    check_camera_arguments(args)
    fov = float(np.deg2rad(args.fov))
    if args.camera_path == RINGS:
        return rings(args.frames, size=args.size, distance=args.distance, fov=fov)
    if args.camera_path.lower().endswith(".json"):
        keys, loop = read_keyframes(args.camera_path, fov)
        return keyframe_path(keys, args.frames, loop=loop, size=args.size)
    return camera_path(args.camera_path, args.frames, size=args.size, fov=fov, distance=args.distance)
