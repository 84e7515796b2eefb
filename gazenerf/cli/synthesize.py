"""`gazenerf synthesize`: pictures of synthetic people with everything known about them."""

from __future__ import annotations

import time
from dataclasses import dataclass

from gazenerf.data.synthesis import SynthesizeOptions, synthesize
from gazenerf.execution import ExecutionOptions
from gazenerf.folders import Folder
from gazenerf.options import option

HELP = "render captures of synthetic people to train on"


@dataclass(frozen=True, kw_only=True)
class Options(ExecutionOptions, SynthesizeOptions):
    """What the command takes.

    Attributes:
        out: The folder; one of the same set is resumed.
    """

    out: Folder = option(help="folder, also by URL; one of the same set is resumed", metavar="DIR", url=True)


def run(options: Options) -> int:
    """Render what is missing and report."""
    from gazenerf.cli.common import showing_progress, summary_table
    from gazenerf.cli.libraries import naming_missing_libraries

    started, total = time.perf_counter(), options.people * options.views
    where = options.where()
    with naming_missing_libraries(), showing_progress() as progress:
        rendered = synthesize(options.out, options, progress, where.workers, where.scheduler)
    seconds = time.perf_counter() - started
    people, views, size = options.people, options.views, options.size
    rows: dict[str, object] = {
        "folder": options.out,
        "captures": f"{total:,} ({people} people, {views} views each, {size}x{size})",
        "rendered now": f"{rendered:,} by {options.renderer} in {seconds:.1f} s, {rendered / seconds:.1f}/s",
    }
    measured = {
        "captures": total,
        "rendered_now": rendered,
        "render_seconds": seconds,
        "workers": None if where.scheduler else where.workers,
    }
    summary_table("captures", rows, measured)
    return 0
