"""`gazenerf synthesize`: pictures of synthetic people with everything known about them."""

from __future__ import annotations

import argparse
import time
from pathlib import Path

HELP = "render captures of synthetic people to train on"


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder; one of the same set is resumed")
    parser.add_argument("--people", type=int, default=16, metavar="N", help="how many people (default: 16)")
    parser.add_argument("--views", type=int, default=90, metavar="N", help="pictures of each (default: 90)")
    parser.add_argument("--size", type=int, default=256, metavar="PX", help="width and height (default: 256)")
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="same seed, same bytes (default: 0)")
    parser.add_argument(
        "--layout",
        default="random",
        metavar="NAME",
        help="cameras: random, or xgaze18 for 18 fixed ones around each pose (default: random)",
    )
    parser.add_argument(
        "--renderer",
        default="pyrender",
        metavar="NAME",
        help="pyrender, or mitsuba for path-traced pictures, which take longer (default: pyrender)",
    )
    parser.add_argument("--supersampling", type=int, metavar="N", help="N x N samples a pixel of pyrender (default: 2)")
    parser.add_argument("--samples", type=int, metavar="N", help="light paths a pixel of mitsuba (default: 64)")


def run(args: argparse.Namespace) -> int:
    """Render what is missing and report."""
    from gazenerf.cli.common import progress, summary_table
    from gazenerf.cli.libraries import naming_missing_libraries
    from gazenerf.data import synthesize
    from gazenerf.errors import UserError

    sampling = {"supersampling": args.supersampling, "samples": args.samples}
    sampling = {name: value for name, value in sampling.items() if value is not None}
    for name, owner in (("supersampling", "pyrender"), ("samples", "mitsuba")):
        if name in sampling and args.renderer != owner:
            raise UserError(f"--{name} is a setting of --renderer {owner}, not of {args.renderer}")
    started, total = time.perf_counter(), args.people * args.views
    seen = 0
    with naming_missing_libraries(), progress("rendering", max(total, 0)) as advance:

        def on_capture(done: int, _: int) -> None:
            nonlocal seen
            advance(done - seen)
            seen = done

        rendered = synthesize(
            args.out,
            args.people,
            args.views,
            args.size,
            args.seed,
            layout=args.layout,
            renderer=args.renderer,
            on_capture=on_capture,
            **sampling,
        )
    seconds = time.perf_counter() - started
    rows: dict[str, object] = {
        "folder": args.out,
        "captures": f"{total:,} ({args.people} people, {args.views} views each, {args.size}x{args.size})",
        "rendered now": f"{rendered:,} by {args.renderer} in {seconds:.1f} s, {rendered / seconds:.1f}/s",
    }
    summary_table("captures", rows)
    return 0
