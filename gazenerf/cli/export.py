"""`gazenerf export`: pictures with their cameras, as other programs train on."""

from __future__ import annotations

from dataclasses import dataclass

from gazenerf.cli.arguments import FolderArguments, GazeArguments, SourceArguments
from gazenerf.export.formats.datasets import DatasetOptions

HELP = "write pictures with their cameras for nerfstudio and COLMAP"


@dataclass(frozen=True, kw_only=True)
class Options(DatasetOptions, GazeArguments, FolderArguments, SourceArguments):
    """What the command takes."""


def run(options: Options) -> int:
    """Render, write, report."""
    from gazenerf.cli.common import showing_progress, summary_table, warn
    from gazenerf.export.formats.datasets import write_dataset

    gaze, cameras = options.checked_gaze(), options.cameras()
    options.check()
    head = options.load()
    if beyond := head.check(gaze):
        warn(str(beyond))
    with showing_progress() as progress:
        written = write_dataset(
            head.at(gaze), options.out, cameras, options, overwrite=options.overwrite, progress=progress
        )
    rows = {"size": f"{len(cameras)} pictures of {options.size}x{options.size}", "units": "metres"}
    measured = {"pictures": len(cameras), "width": options.size, "height": options.size, "units": "metres"}
    summary_table(f"dataset of {head.subject.name}", written | rows, measured)
    return 0
