"""`gazenerf prepare`: captures of a published data set of real people."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

from gazenerf.datasets.examine import Examined
from gazenerf.datasets.options import PrepareOptions
from gazenerf.errors import UserError
from gazenerf.execution import ExecutionOptions
from gazenerf.folders import Folder
from gazenerf.options import option

HELP = "make captures of a published gaze data set to train on"


@dataclass(frozen=True, kw_only=True)
class Options(ExecutionOptions, PrepareOptions):
    """What the command takes.

    Attributes:
        out: Folder of the captures.
        check_only: Only look whether all is there.
        arrows: Picture of labels as arrows, with `check_only`.
        write_pictures: Folder for the pictures, with `check_only`.
    """

    out: Folder | None = option(
        None, "folder of the captures, also by URL; one of the same settings is resumed", metavar="DIR", url=True
    )
    check_only: bool = option(False, "only say what is missing, before anything is fitted", flag="--check")
    arrows: Path | None = option(None, "with --check: a picture of labels as arrows", metavar="FILE.png")
    write_pictures: Path | None = option(
        None, "with --check: write the pictures that --landmarks, --masks and --labels speak of", metavar="DIR"
    )


def run(options: Options) -> int:
    """Check or prepare, and report."""
    from gazenerf.cli.libraries import naming_missing_libraries

    for name in ("arrows", "write_pictures"):
        if getattr(options, name) is not None and not options.check_only:
            raise UserError(f"--{name.replace('_', '-')} goes with --check")
    if options.out is None and not options.check_only:
        raise UserError("give --out DIR for the captures, or --check")
    with naming_missing_libraries():
        return _check(options) if options.check_only else _prepare(options)


def _check(options: Options) -> int:
    from gazenerf.cli.common import showing_progress, summary_table
    from gazenerf.datasets.arrows import write_arrows
    from gazenerf.datasets.examine import examine
    from gazenerf.datasets.write_pictures import write_pictures

    with showing_progress() as progress:
        found, examined = examine(options, progress)
        rows = _rows(options, examined)
        if options.arrows is not None:
            write_arrows(found, options, options.arrows)
            rows["arrows"] = options.arrows
        if options.write_pictures is not None:
            rows["pictures written"] = write_pictures(found, options, options.write_pictures, progress)
    rows["missing"] = "nothing" if not examined.problems else f"{len(examined.problems)}, see below"
    measured = {name: getattr(examined, name) for name in ("subjects", "wanted", "pictures", "turned", "faulty")}
    summary_table("data set", rows, measured)
    examined.refuse()
    return 0


def _prepare(options: Options) -> int:
    from gazenerf.cli.common import showing_progress, summary_table, warn
    from gazenerf.datasets.person_record import CAPTURE, FAILED
    from gazenerf.datasets.prepare import prepare

    assert options.out is not None
    started, where = time.perf_counter(), options.where()
    with showing_progress() as progress:
        made = prepare(options, options.out, progress, warn, where.workers, where.scheduler)
    seconds = time.perf_counter() - started
    now = made.counts.total() - made.before
    rows = _rows(options, made.examined) | {
        "folder": options.out,
        "captures": f"{made.counts[CAPTURE]:,} of {options.size}x{options.size}",
        "failed": f"{made.counts[FAILED]:,}, told in person-*.json",
        "done now": f"{now:,} in {seconds:.1f} s" + (f", {seconds / now:.1f} s each" if now else ""),
    }
    for name, value in (("irises", made.from_irises), ("published head pose", made.from_published_pose)):
        rows[f"labels against {name}"] = "unknown" if value is None else f"{value:.1f} degrees (median)"
    measured = {
        "captures": made.counts[CAPTURE],
        "failed": made.counts[FAILED],
        "done_now": now,
        "seconds": seconds,
        "label_from_irises_degrees": made.from_irises,
        "label_from_published_pose_degrees": made.from_published_pose,
    }
    summary_table("captures", rows, measured)
    return 0


def _rows(options: Options, examined: Examined) -> dict[str, object]:
    about = {
        "data set": f"{options.dataset} ({examined.layout}), split {examined.split}",
        "subjects": f"{examined.subjects} of {examined.wanted}",
        "pictures": f"{examined.pictures:,}",
    }
    if examined.turned or examined.faulty:
        about["left out"] = f"{examined.turned:,} turned too far, {examined.faulty:,} without a usable label"
    return dict(about)
