"""`gazenerf check`: the field's geometry against renders of the subject's head model."""

from __future__ import annotations

import argparse
from pathlib import Path

from gazenerf.errors import UserError

HELP = "measure a field's geometry against renders of the subject's head model"
REFERENCES = {"mitsuba": ("mitsuba",), "pyrender": ("pyrender",), "both": ("mitsuba", "pyrender")}


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    from gazenerf.cli.common import add_gaze_argument, add_source_arguments

    add_source_arguments(parser)
    add_gaze_argument(parser)
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder for report.html and report.json")
    parser.add_argument("--views", type=int, default=8, metavar="N", help="how many views (default: 8)")
    parser.add_argument("--size", type=int, default=192, metavar="PX", help="side of a view (default: 192)")
    parser.add_argument("--reference", default="both", choices=sorted(REFERENCES), help="reference renderer")
    parser.add_argument(
        "--fail-on",
        nargs="+",
        default=[],
        metavar="NAME=X",
        help="exit 1 when a metric of report.json is worse than X or was not measured",
    )
    parser.add_argument("--overwrite", action="store_true", help="replace a report at --out")


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
    """Check, write, report; 1 when a threshold is crossed."""
    from gazenerf.cli.common import checked_gaze, load_bound_factory, progress, summary_table
    from gazenerf.head_model import load_head_model
    from viz.check import check_cameras, check_names, check_subject
    from viz.report import NUMBERS, REPORT, write_report

    thresholds = parse_thresholds(args.fail_on)
    check_names(thresholds)
    gaze = checked_gaze(args.gaze)
    check_cameras(args.views, args.size)
    for name in (REPORT, NUMBERS):
        if (args.out / name).exists() and not args.overwrite:
            raise UserError(f"{args.out / name} exists; add --overwrite or choose another --out")
    subject, bind = load_bound_factory(args)
    if subject.head is None:
        raise UserError(f"{subject.name} has no head-model parameters to check against; choose a subject that has")
    mesh = load_head_model().mesh(subject.head, gaze)
    with progress("checking", total=args.views) as advance:
        result = check_subject(
            bind(gaze),
            mesh,
            views=args.views,
            size=args.size,
            renderers=REFERENCES[args.reference],
            illumination=subject.head.illumination,
            progress=lambda done, total: advance(1),
        )
    crossed = [name for name, limit in thresholds.items() if result.metric(name).crosses(limit)]
    page, numbers = write_report(result, args.out)
    rows: dict[str, object] = {"report": page, "numbers": numbers}
    rows |= {m.label: f"{_short(m.value)} {m.unit} ({m.verdict})".replace("  ", " ") for m in result.metrics}
    rows |= {f"{name} could not start": fix for name, fix in result.missing.items()}
    if crossed:
        rows["thresholds crossed"] = ", ".join(crossed)
    summary_table(f"check of {subject.name}", rows)
    return 1 if crossed else 0


def _short(value: float) -> str:
    """Three digits, and no powers of ten for areas."""
    return f"{value:,.0f}" if abs(value) >= 1000.0 else f"{value:.3g}"
