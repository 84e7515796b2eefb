"""`gazenerf sheet`: many gazes or views of one head in one labelled picture."""

from __future__ import annotations

from dataclasses import dataclass

from gazenerf.cli.arguments import PictureArguments, SourceArguments
from gazenerf.viz.pictures.make_sheet import SheetOptions

HELP = "put many gazes or views of a head into one labelled picture"


@dataclass(frozen=True, kw_only=True)
class Options(SheetOptions, PictureArguments, SourceArguments):
    """What the command takes."""


def run(options: Options) -> int:
    """Draw the tiles, write the picture, and print what was written."""
    from gazenerf.cli.common import showing_progress, summary_table, warn
    from gazenerf.viz.pictures.make_sheet import check_sheet, make_sheet, sheet_gazes

    check_sheet(options.out, options, options.overwrite)
    head = options.load()
    if beyond := head.check(gaze for row in sheet_gazes(options, head.trained_range) for gaze in row):
        warn(str(beyond))
    with showing_progress() as progress:
        made = make_sheet(head, options.out, options, overwrite=options.overwrite, progress=progress)
    rows = {
        "picture": made.file,
        "size": f"{made.width}x{made.height}, {made.tiles} tiles",
        "rendered in": f"{made.seconds:.1f} s, {made.tiles / made.seconds:.2f} tiles/s",
    }
    measured = {"width": made.width, "height": made.height, "tiles": made.tiles, "render_seconds": made.seconds}
    summary_table(f"{options.kind} of {head.subject.name}", rows, measured)
    return 0
