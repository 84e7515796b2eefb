"""`gazenerf check`: a field, or somebody else's frames, measured for consistency; two measurements side by side."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gazenerf.errors import UserError

if TYPE_CHECKING:
    from gazenerf.viz.metrics.definitions import Definition, Metric

HELP = "measure whether a field, or a folder of frames, is one consistent 3D head"
REFERENCES = {"mitsuba": ("mitsuba",), "pyrender": ("pyrender",), "both": ("mitsuba", "pyrender")}

VIEWS, SIZE, GAZES = 12, 256, 5
"""Defaults for a field."""


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    from gazenerf.cli.common import add_gaze_argument, add_source_arguments

    add_source_arguments(parser)
    add_gaze_argument(parser)
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder for report.html, report.json and error.glb")
    parser.add_argument("--overwrite", action="store_true", help="replace a report at --out")
    parser.add_argument("--views", type=int, metavar="N", help=f"how many views (default: {VIEWS}; of frames: 120)")
    parser.add_argument("--gazes", type=int, default=GAZES, metavar="N", help="gazes of the eyes, 1 to 5 (default: 5)")
    parser.add_argument(
        "--size", type=int, metavar="PX", help=f"side of a view (default: {SIZE}; longest side of frames: 768)"
    )
    parser.add_argument("--reference", default="both", choices=sorted(REFERENCES), help="reference renderer")
    parser.add_argument("--sfm", action="store_true", help="also run COLMAP (needs the extra sfm)")
    parser.add_argument("--no-error-mesh", action="store_true", help="write no error.glb, which takes a while")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of samples and error bars (default: 0)")
    parser.add_argument(
        "--fail-on",
        nargs="+",
        default=[],
        metavar="NAME=X",
        help="exit 1 when a metric of report.json is worse than X or was not measured",
    )
    other = parser.add_mutually_exclusive_group()
    other.add_argument(
        "--frames", type=Path, metavar="DIR", help="measure a folder of pictures with a transforms.json instead"
    )
    other.add_argument(
        "--compare",
        nargs=2,
        type=Path,
        metavar=("A", "B"),
        help="put two report.json files side by side; --out DIR also writes compare.html",
    )


def parse_thresholds(texts: list[str]) -> dict[str, float]:
    """NAME=X pairs as a dictionary.

    Raises:
        UserError: not NAME=NUMBER.
    """
    out = {}
    for text in texts:
        name, separator, value = text.partition("=")
        try:
            if not separator:
                raise ValueError
            out[name] = float(value)
        except ValueError as error:
            raise UserError(f"--fail-on {text}: write NAME=NUMBER, such as depth_median_mm=3") from error
    return out


def run(args: argparse.Namespace) -> int:
    """Measure, write, report; 1 when a threshold is crossed."""
    if args.compare is not None:
        return _compare(args)
    if args.out is None:
        raise UserError("say where the report goes: --out DIR")
    if args.seed < 0:
        raise UserError(f"--seed must be 0 or more, got {args.seed}")
    return _check_frames(args) if args.frames is not None else _check_field(args)


def _check_field(args: argparse.Namespace) -> int:
    from gazenerf.cli.common import checked_gaze, load_bound_factory, summary_table
    from gazenerf.head_model import load_head_model
    from gazenerf.viz.check.field import check_cameras, check_subject
    from gazenerf.viz.check.workers import pool
    from gazenerf.viz.metrics.eyes import gaze_grid
    from gazenerf.viz.metrics.families import CHECK_DEFINITIONS
    from gazenerf.viz.metrics.orbit_pictures import measure_orbit
    from gazenerf.viz.report.error_mesh import FILE, error_mesh
    from gazenerf.viz.report.write import write_report

    thresholds = _thresholds(args, CHECK_DEFINITIONS)
    gaze, views, size = checked_gaze(args.gaze), _given(args.views, VIEWS), _given(args.size, SIZE)
    check_cameras(views, size)
    gazes = gaze_grid(gaze)
    if not 1 <= args.gazes <= len(gazes):
        raise UserError(f"--gazes must lie between 1 and {len(gazes)}, got {args.gazes}")
    _refuse_existing(args, FILE)
    subject, bind = load_bound_factory(args)
    if subject.head is None:
        raise UserError(f"{subject.name} has no head-model parameters to check against; choose a subject that has")
    head, model = subject.head, load_head_model()
    bound, mesh = bind(gaze), model.mesh(subject.head, gaze)
    several = args.gazes > 1
    with _steps("checking") as tell:
        result = check_subject(
            bound,
            mesh,
            views=views,
            size=size,
            renderers=REFERENCES[args.reference],
            illumination=head.illumination,
            bind=bind if several else None,
            mesh_at=(lambda other: model.mesh(head, other)) if several else None,
            gazes=gazes[: args.gazes],
            seed=args.seed,
            progress=tell,
        )
    with _steps("following features") as tell, pool() as executor:
        result = measure_orbit(result, bound, size, sfm=args.sfm, seed=args.seed, run=executor.map, progress=tell)
    error = None
    if not args.no_error_mesh:
        with _steps("error mesh") as tell:
            error = error_mesh(bound, mesh, progress=lambda stage, done, total: tell(done, total))
    crossed = [name for name, limit in thresholds.items() if result.metric(name).crosses(limit)]
    page, numbers = write_report(result, args.out, error=error, bound=bound)
    rows: dict[str, object] = {"report": page, "numbers": numbers}
    rows |= {} if error is None else {"error mesh": args.out / FILE}
    rows |= _metric_rows(result.metrics)
    rows |= {f"{name} could not start": fix for name, fix in result.missing.items()}
    rows |= {f"note {i}": note for i, note in enumerate(result.notes, 1)}
    summary_table(f"check of {subject.name}", rows | _crossed(crossed))
    return 1 if crossed else 0


def _check_frames(args: argparse.Namespace) -> int:
    from gazenerf.cli.common import summary_table
    from gazenerf.viz.check.frames import LONGEST_PX, MOST_FRAMES, read_frames
    from gazenerf.viz.check.frames_check import check_frames
    from gazenerf.viz.metrics.families import FRAMES_DEFINITIONS
    from gazenerf.viz.report.frames_report import write_frames_report

    thresholds = _thresholds(args, FRAMES_DEFINITIONS)
    _refuse_existing(args)
    folder = read_frames(args.frames, most=_given(args.views, MOST_FRAMES), longest_px=_given(args.size, LONGEST_PX))
    name = args.frames.resolve().name
    with _steps("checking") as tell:
        result = check_frames(folder, name=name, sfm=args.sfm, seed=args.seed, progress=tell)
    crossed = [metric for metric, limit in thresholds.items() if result.metric(metric).crosses(limit)]
    page, numbers = write_frames_report(result, args.out)
    rows: dict[str, object] = {"report": page, "numbers": numbers} | _metric_rows(result.metrics)
    rows |= {f"{what}: not measured": why for what, why in result.unmeasured.items()}
    rows |= {f"note {i}": note for i, note in enumerate(result.notes, 1)}
    summary_table(f"check of the frames of {name}", rows | _crossed(crossed))
    return 1 if crossed else 0


def _compare(args: argparse.Namespace) -> int:
    from rich.console import Console
    from rich.table import Table

    from gazenerf.viz.check.compare import compare_reports
    from gazenerf.viz.report.comparison import PAGE, summary, terminal_rows, write_comparison

    if args.fail_on:
        raise UserError("--fail-on gates a measurement, not a comparison; leave it out with --compare")
    comparison = compare_reports(*args.compare)
    if args.out is not None:
        _refuse_existing(args, PAGE, reports=False)
    table = Table(title="second against first", title_justify="left")
    for heading in ("", *comparison.names, "change", "second is"):
        table.add_column(heading, overflow="fold")
    for row in terminal_rows(comparison):
        table.add_row(*row)
    console = Console(markup=False, highlight=False)
    console.print(table)
    console.print(summary(comparison))
    for difference in comparison.differences:
        console.print(f"not made alike: {difference}")
    if args.out is not None:
        console.print(f"page: {write_comparison(comparison, args.out)}")
    return 0


def _thresholds(args: argparse.Namespace, definitions: Sequence[Definition]) -> dict[str, float]:
    from gazenerf.viz.metrics.definitions import check_names

    thresholds = parse_thresholds(args.fail_on)
    check_names(thresholds, definitions)
    return thresholds


def _refuse_existing(args: argparse.Namespace, *more: str, reports: bool = True) -> None:
    from gazenerf.viz.report.write import NUMBERS, REPORT

    for name in (*((REPORT, NUMBERS) if reports else ()), *more):
        if (args.out / name).exists() and not args.overwrite:
            raise UserError(f"{args.out / name} exists; add --overwrite or choose another --out")


@contextmanager
def _steps(title: str) -> Iterator[Callable[[int, int], None]]:
    """A progress line that is told (steps done, all steps), one step at a time."""
    from gazenerf.cli.common import progress

    with progress(title, total=1) as advance:
        yield lambda done, total: advance(1, total=total)


def _given(value: int | None, default: int) -> int:
    return default if value is None else value


def _metric_rows(metrics: Sequence[Metric]) -> dict[str, object]:
    """Label to value, error bar and verdict; what was not measured shares one row."""
    import math

    rows: dict[str, object] = {}
    for metric in metrics:
        if metric.verdict != "unmeasured":
            bar = f" ± {_short(metric.error)}" if math.isfinite(metric.error) else ""
            rows[metric.label] = f"{_short(metric.value)}{bar} {metric.unit} ({metric.verdict})".replace("  ", " ")
    if absent := [metric.label for metric in metrics if metric.verdict == "unmeasured"]:
        rows["not measured"] = "; ".join(absent)
    return rows


def _crossed(names: Sequence[str]) -> dict[str, Any]:
    return {"thresholds crossed": ", ".join(names)} if names else {}


def _short(value: float) -> str:
    """Three digits, and no powers of ten for areas."""
    return f"{value:,.0f}" if abs(value) >= 1000.0 else f"{value:.3g}"
