"""`gazenerf orbit`: a video that flies around a head while its eyes turn."""

from __future__ import annotations

import argparse
import time
from contextlib import nullcontext

import numpy as np

from gazenerf.errors import UserError
from gazenerf.geometry import Camera, Gaze
from gazenerf.geometry.keyframes import keyframe_path, read_keyframes
from gazenerf.geometry.paths import CAMERA_PATHS, GAZE_PATHS, PUBLISHED_FRAMES, camera_path, gaze_path

HELP = "render a video that flies around a head while its eyes turn"


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    from gazenerf.cli.views import add_camera_arguments, add_scene_arguments
    from gazenerf.viz.pictures.panels import PANELS

    add_scene_arguments(parser, ".mp4, .gif, .webp, frames/%%04d.png, or a folder for numbered pictures")
    eyes = parser.add_argument_group("eyes (degrees; pitch up, yaw to the subject's left)")
    eyes.add_argument(
        "--gaze",
        nargs=2,
        type=float,
        action="append",
        default=[],
        metavar=("PITCH", "YAW"),
        help="where the eyes look; repeat it for --gaze-path targets",
    )
    eyes.add_argument(
        "--gaze-path",
        metavar="NAME",
        help=f"{', '.join(GAZE_PATHS)} (default: hold with one --gaze, targets with several, else look-at-camera)",
    )
    flight = add_camera_arguments(parser)
    flight.add_argument(
        "--camera-path",
        default="horizontal",
        metavar="NAME",
        help=f"{', '.join(CAMERA_PATHS)}, or a .json file of keyframes (default: horizontal)",
    )
    flight.add_argument("--frames", type=int, metavar="N", help="number of frames (default: 90; 45 for circle)")
    flight.add_argument(
        "--sweep", type=float, metavar="DEG", help="largest yaw of horizontal (60) and figure-eight (45)"
    )
    flight.add_argument("--yaw", type=float, default=0.0, metavar="DEG", help="direction of still and dolly")
    flight.add_argument(
        "--pitch", type=float, metavar="DEG", help="height of the path; of figure-eight the largest (15)"
    )
    look = parser.add_argument_group("picture and file")
    look.add_argument(
        "--panels", nargs="+", default=["image"], metavar="PANEL", help=f"{', '.join(PANELS)} (default: image)"
    )
    look.add_argument("--columns", type=int, metavar="N", help="panels in a row")
    look.add_argument("--no-labels", action="store_true", help="do not name the panels in the picture")
    look.add_argument("--geometry-size", type=int, metavar="PX", help="width behind depth, opacity and normals panels")
    look.add_argument("--fps", type=float, default=30.0, metavar="N", help="frames a second (default: 30)")
    look.add_argument(
        "--speed",
        default="auto",
        metavar="PATH",
        help="exact (every sample), guided (around the surface), baked (interpolated, checked against guided), "
        "or auto: baked from 16 frames on (default: auto)",
    )
    look.add_argument("--crf", type=int, default=17, metavar="N", help="H.264 quality, 0 best to 51 (default: 17)")


def run(args: argparse.Namespace) -> int:
    """Render, write the video and its sidecar, and print what was written."""
    from gazenerf.cli.common import progress
    from gazenerf.cli.views import (
        counted,
        eye_midpoint,
        gaze_limits,
        load_scene,
        refuse_existing,
        say,
        warn,
    )
    from gazenerf.heads.choose import choose_path
    from gazenerf.heads.head import Head
    from gazenerf.viz.pictures.orbit import frame_size, orbit_sidecar, render_orbit, sidecar_path, write_sidecar
    from gazenerf.viz.pictures.panels import check_panels
    from gazenerf.viz.pictures.reference_panel import head_pictures
    from gazenerf.viz.pictures.video import check_video, write_video

    _check(args)
    cameras = plan_cameras(args)
    check_panels(args.panels, lambda camera, gaze: np.empty(0))  # names only; the renderer needs the subject
    width, height = frame_size(cameras[0], args.panels, args.columns)
    check_video(args.out, width, height, args.fps)
    refuse_existing(args.out, args.overwrite)
    name = args.gaze_path or ("targets" if len(args.gaze) > 1 else "hold" if args.gaze else "look-at-camera")
    if name not in GAZE_PATHS:
        raise UserError(f"unknown gaze path {name!r}; choose {', '.join(GAZE_PATHS)}")

    field, subject = load_scene(args)
    head, limits = Head(field, subject), gaze_limits(field)
    given = [Gaze.from_degrees(pitch, yaw) for pitch, yaw in args.gaze]
    eyes = eye_midpoint(subject) if name == "look-at-camera" else np.zeros(3)
    gazes = gaze_path(name, cameras, gazes=given, limits=limits, eyes=eyes)
    if beyond := head.check(gazes):
        warn(str(beyond))
    started = time.perf_counter()
    path = choose_path(head, cameras, gazes, args.speed)
    if path.note:
        warn(path.note)
    with head_pictures(subject, (args.size, args.size)) if "reference" in args.panels else nullcontext() as reference:
        frames = render_orbit(
            path.head,
            cameras,
            gazes,
            args.panels,
            reference=reference,
            columns=args.columns,
            labels=False if args.no_labels else None,
            geometry_size=args.geometry_size,
        )
        with progress("rendering", len(cameras)) as advance:
            files = write_video(args.out, counted(frames, advance), args.fps, args.crf)
    seconds = time.perf_counter() - started
    about = {"camera_path": args.camera_path, "gaze_path": name, "width": width, "height": height, "speed": path.name}
    bound = path.head.at(gazes[0])
    sidecar = orbit_sidecar(bound, cameras, gazes, panels=args.panels, fps=args.fps, about=about)
    written = write_sidecar(args.out, sidecar)
    assert written == sidecar_path(args.out)
    say(
        f"orbit of {subject.name}",
        {
            "video" if len(files) == 1 else "pictures": files[0]
            if len(files) == 1
            else f"{files[0]} .. {files[-1].name}",
            "sidecar": written,
            "frames": f"{len(cameras)} of {width}x{height}, {len(cameras) / args.fps:.1f} s at {args.fps:g} fps",
            "size": f"{sum(file.stat().st_size for file in files) / 1024:,.0f} KiB",
            "path": path.describe(),
            "rendered in": f"{seconds:.1f} s, {len(cameras) / seconds:.2f} frames/s",
        },
    )
    return 0


def plan_cameras(args: argparse.Namespace) -> list[Camera]:
    """The camera of every frame.

    Raises:
        UserError: arguments that make no camera.
    """
    fov = float(np.deg2rad(args.fov))
    frames = args.frames if args.frames is not None else PUBLISHED_FRAMES if args.camera_path == "circle" else 90
    if args.camera_path.lower().endswith(".json"):
        keys, loop = read_keyframes(args.camera_path, fov)
        return keyframe_path(keys, frames, loop=loop, size=args.size)
    return camera_path(
        args.camera_path,
        frames,
        size=args.size,
        fov=fov,
        distance=args.distance,
        sweep=None if args.sweep is None else float(np.deg2rad(args.sweep)),
        yaw=float(np.deg2rad(args.yaw)),
        pitch=None if args.pitch is None else float(np.deg2rad(args.pitch)),
    )


def _check(args: argparse.Namespace) -> None:
    from gazenerf.cli.views import check_camera_arguments

    check_camera_arguments(args)
    for name in ("columns", "geometry_size"):
        value = getattr(args, name)
        if value is not None and value < 1:
            raise UserError(f"--{name.replace('_', '-')} must be at least 1, got {value}")
    if not 0 <= args.crf <= 51:
        raise UserError(f"--crf goes from 0 (lossless) to 51, got {args.crf}")
    angles = [*np.ravel(args.gaze), args.yaw, args.pitch or 0.0, args.sweep or 0.0]
    if not np.isfinite(angles).all():
        raise UserError("angles must be finite numbers of degrees")
