"""`gazenerf mesh`: face and eyes as meshes in metres."""

from __future__ import annotations

import argparse
from pathlib import Path

HELP = "extract face and eye meshes from the density volumes"


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    from gazenerf.cli.common import add_gaze_argument, add_source_arguments

    add_source_arguments(parser)
    add_gaze_argument(parser)
    parser.add_argument(
        "--out", type=Path, required=True, metavar="DIR", help="folder for the meshes and their sidecars"
    )
    parser.add_argument("--parts", nargs="+", default=["face", "eyes"], metavar="PART", help="face, eyes, head")
    parser.add_argument("--resolution", type=int, default=192, metavar="N", help="grid points along the longest side")
    parser.add_argument(
        "--threshold", default="auto", metavar="auto|X", help="density of the surface: auto, a number, or p50"
    )
    parser.add_argument("--formats", nargs="+", default=["glb", "ply", "obj"], metavar="F", help="glb, ply, obj")
    parser.add_argument("--rig", action="store_true", help="also write rig.glb, one file whose eyes turn")
    parser.add_argument(
        "--method", choices=("flying-edges", "lewiner"), default="flying-edges", help="how the surface is extracted"
    )
    parser.add_argument("--smooth", type=int, default=0, metavar="N", help="rounds of smoothing that keeps the volume")
    parser.add_argument("--max-faces", type=int, metavar="N", help="decimate each part to at most N triangles")
    parser.add_argument("--no-colours", action="store_true", help="leave the meshes grey")
    parser.add_argument("--overwrite", action="store_true", help="replace meshes at --out")


def run(args: argparse.Namespace) -> int:
    """Extract, write, report."""
    from export import mesh_subject
    from export.report import mesh_rows, rig_rows
    from gazenerf.cli.common import checked_gaze, load_bound_factory, progress, summary_table

    gaze = checked_gaze(args.gaze)
    _, bind = load_bound_factory(args)
    with progress("meshing", total=0) as advance:
        meshes = mesh_subject(
            bind(gaze),
            args.out,
            parts=tuple(args.parts),
            resolution=args.resolution,
            threshold=args.threshold,
            formats=tuple(args.formats),
            colours=not args.no_colours,
            method=args.method,
            smoothing=args.smooth,
            max_faces=args.max_faces,
            bind=bind if args.rig else None,
            overwrite=args.overwrite,
            progress=lambda stage, done, total: advance(0, f"{stage} {done / total:.0%}"),
        )
    rows = mesh_rows(meshes, args.out, args.formats)
    if args.rig:
        rows |= {"rig glb": args.out / "rig.glb", "rig json": args.out / "rig.json", **rig_rows(args.out / "rig.json")}
    summary_table("meshes", rows)
    return 0
