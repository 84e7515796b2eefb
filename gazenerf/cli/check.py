"""`gazenerf check`: a field, or any method's frames, measured for consistency; two measurements side by side."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from gazenerf.cli.arguments import GazeArguments, SourceArguments
from gazenerf.errors import UserError
from gazenerf.options import option
from gazenerf.viz.check.options import CheckOptions, parse_limits

if TYPE_CHECKING:
    from gazenerf.heads import Head
    from gazenerf.progress import Progress
    from gazenerf.viz.check.frames_check import FramesResult
    from gazenerf.viz.check.result import CheckResult
    from gazenerf.viz.metrics.definitions import Metric

HELP = "measure whether a field, or a folder of frames, is one consistent 3D head"


@dataclass(frozen=True, kw_only=True)
class ReportArguments:
    """Where a report goes.

    Attributes:
        out: A folder.
        overwrite: Replace what is there.
    """

    out: Path | None = option(None, "folder for report.html, report.json and error.glb", metavar="DIR")
    overwrite: bool = option(False, "replace a report at --out")

    def place(self, *names: str) -> Path:
        """The folder.

        Raises:
            UserError: it was not given, or holds one of these files and may not be overwritten.
        """
        from gazenerf.files import refuse_existing

        if self.out is None:
            raise UserError("say where the report goes: --out DIR")
        refuse_existing([self.out / name for name in names], self.overwrite)
        return self.out


@dataclass(frozen=True, kw_only=True)
class Options(CheckOptions, ReportArguments, GazeArguments, SourceArguments):
    """What the command takes.

    Attributes:
        frames: A folder of pictures to measure instead of a field.
        compare: Two reports to put side by side instead.
        list_metrics: Print what can be measured instead.
    """

    frames: Path | None = option(
        None, "measure a folder of pictures with a transforms.json or a COLMAP model", metavar="DIR", only_one="what"
    )
    compare: tuple[Path, Path] | None = option(
        None,
        "put two report.json files side by side; --out DIR also writes compare.html",
        metavar=("A", "B"),
        only_one="what",
    )
    list_metrics: bool = option(False, "print every metric's name and meaning instead", only_one="what")


def run(options: Options) -> int:
    """Measure, write, report; 1 when a threshold is crossed."""
    if options.list_metrics:
        from gazenerf.cli.check_tables import list_metrics

        return list_metrics()
    if options.compare is not None:
        from gazenerf.cli.check_tables import compare
        from gazenerf.viz.report.comparison import PAGE

        if options.fail_on:
            raise UserError("--fail-on gates a measurement, not a comparison; leave it out with --compare")
        return compare(options.compare, None if options.out is None else options.place(PAGE))
    return _check_field(options) if options.frames is None else _check_frames(options, options.frames)


def measure(options: Options, head: Head, progress: Progress) -> tuple[CheckResult, dict[str, Path]]:
    """Check a head and write its report.

    Returns:
        What was found, and kind to file.
    """
    from gazenerf.viz.check.field import check_subject, reference_of
    from gazenerf.viz.report.error_mesh import FILE, error_mesh
    from gazenerf.viz.report.write import NUMBERS, REPORT, write_report

    out, gaze = options.place(REPORT, NUMBERS, FILE), options.checked_gaze()
    reference, bound = reference_of(head.subject), head.at(gaze)
    result = check_subject(head, reference, options, gaze=gaze, progress=progress)
    error = error_mesh(bound, reference.at(gaze), progress=progress) if options.error_mesh else None
    page, numbers = write_report(result, out, error=error, bound=bound)
    files = {"report": page, "numbers": numbers}
    return result, files if error is None else files | {"error mesh": out / FILE}


def _check_field(options: Options) -> int:
    from gazenerf.cli.common import showing_progress, summary_table, warn
    from gazenerf.viz.check.field import reference_of, swept_gazes
    from gazenerf.viz.metrics.families import CHECK_DEFINITIONS
    from gazenerf.viz.report.error_mesh import FILE
    from gazenerf.viz.report.write import NUMBERS, REPORT

    options.place(REPORT, NUMBERS, FILE)
    gaze = options.checked_gaze()
    options.refuse_impossible()
    parse_limits(options.fail_on, CHECK_DEFINITIONS)
    head = options.load()
    reference_of(head.subject)
    if beyond := head.check(swept_gazes(gaze, options)):
        warn(str(beyond))
    with showing_progress() as progress:
        result, files = measure(options, head, progress)
    crossed = result.crossed(options.fail_on)
    rows: dict[str, object] = dict(files)
    rows |= _metric_rows(result.metrics)
    rows |= {f"{name} could not start": fix for name, fix in result.missing.items()}
    rows |= _last_rows(result.notes, crossed)
    summary_table(f"check of {head.subject.name}", rows, _facts(result, crossed) | {"missing": result.missing})
    return 1 if crossed else 0


def _check_frames(options: Options, folder: Path) -> int:
    from gazenerf.cli.common import showing_progress, summary_table
    from gazenerf.viz.check.frames import LONGEST_PX, MOST_FRAMES, read_frames
    from gazenerf.viz.check.frames_check import check_frames
    from gazenerf.viz.metrics.families import FRAMES_DEFINITIONS
    from gazenerf.viz.report.frames_report import write_frames_report
    from gazenerf.viz.report.write import NUMBERS, REPORT

    out = options.place(REPORT, NUMBERS)
    parse_limits(options.fail_on, FRAMES_DEFINITIONS)
    frames = read_frames(
        folder,
        most=MOST_FRAMES if options.views is None else options.views,
        longest_px=LONGEST_PX if options.size is None else options.size,
    )
    name = folder.resolve().name
    with showing_progress() as progress:
        result = check_frames(frames, name=name, sfm=options.sfm, seed=options.seed, progress=progress)
    page, numbers = write_frames_report(result, out)
    crossed = result.crossed(options.fail_on)
    rows: dict[str, object] = {"report": page, "numbers": numbers} | _metric_rows(result.metrics)
    rows |= {f"{what}: not measured": why for what, why in result.unmeasured.items()}
    rows |= _last_rows(result.notes, crossed)
    summary_table(f"check of the frames of {name}", rows, _facts(result, crossed) | {"unmeasured": result.unmeasured})
    return 1 if crossed else 0


def _facts(result: CheckResult | FramesResult, crossed: Sequence[str]) -> dict[str, object]:
    """What is measured, for programs: metric to value, error bar, unit and verdict."""
    metrics = {
        metric.name: {"value": metric.value, "error": metric.error, "unit": metric.unit, "verdict": metric.verdict}
        for metric in result.metrics
    }
    return {"metrics": metrics, "notes": result.notes, "thresholds_crossed": crossed}


def _metric_rows(metrics: Sequence[Metric]) -> dict[str, object]:
    """Label to value, error bar and verdict; what was not measured shares one row."""
    rows: dict[str, object] = {}
    for metric in metrics:
        if metric.verdict != "unmeasured":
            bar = f" ± {_short(metric.error)}" if math.isfinite(metric.error) else ""
            rows[metric.label] = f"{_short(metric.value)}{bar} {metric.unit} ({metric.verdict})".replace("  ", " ")
    if absent := [metric.label for metric in metrics if metric.verdict == "unmeasured"]:
        rows["not measured"] = "; ".join(absent)
    return rows


def _last_rows(notes: Sequence[str], crossed: Sequence[str]) -> dict[str, object]:
    rows: dict[str, object] = {f"note {i}": note for i, note in enumerate(notes, 1)}
    return rows | ({"thresholds crossed": ", ".join(crossed)} if crossed else {})


def _short(value: float) -> str:
    """Three digits, and no powers of ten for areas."""
    return f"{value:,.0f}" if abs(value) >= 1000.0 else f"{value:.3g}"
