"""`gazenerf mesh`: face and eyes as meshes, textures, points and volumes in metres."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from gazenerf.errors import UserError
from gazenerf.geometry import Camera, Gaze
from gazenerf.geometry.paths import GazeRange, gaze_path

HELP = "extract face and eye meshes from the density volumes"


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    from gazenerf.cli.common import add_gaze_argument, add_source_arguments

    add_source_arguments(parser)
    add_gaze_argument(parser)
    parser.add_argument(
        "--out", type=Path, required=True, metavar="DIR", help="folder for the files and their sidecars"
    )
    parser.add_argument(
        "--for",
        dest="use",
        choices=("blender", "web", "print", "research"),
        help="settings that fit a use (docs/meshes.md); what is given beside it wins",
    )
    parser.add_argument("--parts", nargs="+", metavar="PART", help="face, eyes, head (default: face eyes)")
    parser.add_argument("--overwrite", action="store_true", help="replace files at --out")
    surface = parser.add_argument_group("surface")
    surface.add_argument(
        "--resolution", type=int, metavar="N", help="grid points along the longest side (default: 192)"
    )
    surface.add_argument(
        "--threshold", default="auto", metavar="auto|X", help="density of the surface: auto, a number, or p50"
    )
    surface.add_argument(
        "--surface",
        choices=("isosurface", "tsdf", "poisson"),
        default="isosurface",
        help="of the density, or of depth in pictures all around: fused (tsdf), or a fitted solid (poisson)",
    )
    surface.add_argument(
        "--method", choices=("flying-edges", "lewiner"), default="flying-edges", help="how an isosurface is extracted"
    )
    surface.add_argument("--repair", action="store_const", const=True, help="make the surface manifold")
    surface.add_argument(
        "--drop-hidden", action="store_const", const=True, help="drop pieces that cannot be seen from outside"
    )
    surface.add_argument("--close-holes", type=float, metavar="MM", help="close holes up to this radius; inf for all")
    surface.add_argument("--smooth", type=int, metavar="N", help="rounds of smoothing that keeps the volume")
    surface.add_argument("--max-faces", type=int, metavar="N", help="decimate each part to at most N triangles")
    written = parser.add_argument_group("what is written")
    written.add_argument("--formats", nargs="+", metavar="F", help="glb, ply, obj, stl, usdz (default: glb ply obj)")
    written.add_argument("--no-colours", action="store_true", help="leave the meshes grey")
    written.add_argument(
        "--texture",
        type=int,
        choices=(1024, 2048, 4096),
        help="give glb, obj and usdz a texture of so many pixels a side",
    )
    written.add_argument("--points", type=int, metavar="N", help="also write N coloured points of each surface")
    written.add_argument("--volume", nargs="+", metavar="F", help="also write the densities: nrrd, vti, npz")
    written.add_argument("--rig", action="store_const", const=True, help="also write rig.glb, one file whose eyes turn")
    written.add_argument(
        "--no-rig", dest="rig", action="store_const", const=False, help="no rig.glb where --for would write one"
    )
    moving = parser.add_argument_group("gaze sequence (degrees; pitch up, yaw to the subject's left)")
    moving.add_argument(
        "--sequence",
        choices=("sweep", "circle", "targets"),
        help="also write sequence.glb, whose eyes turn along a gaze path and whose lids follow",
    )
    moving.add_argument(
        "--sequence-gaze",
        nargs=2,
        type=float,
        action="append",
        default=[],
        metavar=("PITCH", "YAW"),
        help="a gaze of --sequence targets; repeat it",
    )
    moving.add_argument("--sequence-frames", type=int, default=24, metavar="N", help="gazes, 12 a second (default: 24)")
    moving.add_argument(
        "--sequence-files", action="store_true", help="write the parts at every gaze instead, into sequence/0000 ..."
    )


def run(args: argparse.Namespace) -> int:
    """Extract, write, report."""
    from gazenerf.cli.common import checked_gaze, progress, summary_table
    from gazenerf.cli.views import beyond_training, binder, gaze_limits, load_scene, warn
    from gazenerf.export import mesh_subject
    from gazenerf.export.options import RIGGED
    from gazenerf.export.summary import mesh_rows, rig_rows, sequence_rows

    gaze = checked_gaze(args.gaze)
    chosen = chosen_settings(args)
    rigged = args.use in RIGGED and {"face", "eyes"} <= set(chosen["parts"]) if args.rig is None else args.rig
    field, subject = load_scene(args)
    bind = binder(field, subject)
    sequence = chosen_gazes(args, gaze_limits(field))
    if note := beyond_training(field, [gaze, *sequence]):
        warn(note)
    with progress("meshing", total=0) as advance:
        meshes = mesh_subject(
            bind(gaze),
            args.out,
            threshold=args.threshold,
            method=args.method,
            surface=args.surface,
            bind=bind if rigged or sequence else None,
            sequence=sequence,
            numbered=args.sequence_files,
            overwrite=args.overwrite,
            progress=lambda stage, done, total: advance(0, f"{stage} {done / max(total, 1):.0%}"),
            **chosen,
        )
    rows = mesh_rows(meshes, args.out, chosen["formats"], chosen["volumes"])
    if rigged or sequence:
        rows |= rig_rows(args.out)
    if sequence:
        rows |= sequence_rows(args.out, numbered=args.sequence_files)
    summary_table("meshes", rows)
    return 0


def chosen_settings(args: argparse.Namespace) -> dict[str, Any]:
    """Keyword arguments of `export.mesh_subject` from a preset and what was given beside it."""
    from gazenerf.export.options import settings

    given = {
        "parts": _tuple(args.parts),
        "resolution": args.resolution,
        "formats": _tuple(args.formats),
        "repair": args.repair,
        "seen": args.drop_hidden,
        "holes_mm": args.close_holes,
        "smoothing": args.smooth,
        "max_faces": args.max_faces,
        "colours": False if args.no_colours else None,
        "texture": args.texture,
        "points": args.points,
        "volumes": _tuple(args.volume),
    }
    return settings(args.use, given)


def chosen_gazes(args: argparse.Namespace, limits: GazeRange) -> list[Gaze]:
    """The gazes of a sequence, none where there is no `--sequence`.

    Raises:
        UserError: settings that do not go together, or impossible gazes.
    """
    from gazenerf.cli.common import checked_gaze

    if args.sequence is None:
        if args.sequence_gaze or args.sequence_files:
            raise UserError("--sequence-gaze and --sequence-files need --sequence")
        return []
    if args.sequence_frames < 2:
        raise UserError(f"--sequence-frames must be at least 2, got {args.sequence_frames}")
    if args.sequence_gaze and args.sequence != "targets":
        raise UserError(f"--sequence-gaze needs --sequence targets, not {args.sequence}")
    chosen = [checked_gaze(angles) for angles in args.sequence_gaze]
    return gaze_path(args.sequence, [Camera.neutral(64)] * args.sequence_frames, gazes=chosen, limits=limits)


def _tuple(words: list[str] | None) -> tuple[str, ...] | None:
    return None if words is None else tuple(dict.fromkeys(words))
