"""`gazenerf evaluate`: quality of a field on views, gazes and people that it has not seen."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.table import Table

from gazenerf.evaluation.intervals import SHARE, Estimate
from gazenerf.evaluation.paper import PaperEvaluation, evaluate_redirection
from gazenerf.evaluation.quality import UNITS
from gazenerf.evaluation.redirection import UNITS as PAPER_UNITS
from gazenerf.evaluation.run import EvaluateOptions, Evaluation, evaluate
from gazenerf.execution import ExecutionOptions
from gazenerf.options import option

HELP = "measure a field on views, gazes and people it has not seen"


@dataclass(frozen=True, kw_only=True)
class Options(ExecutionOptions, EvaluateOptions):
    """What the command takes.

    Attributes:
        workers: One uses all cores by threads, and is the default.
    """

    workers: int | None = option(None, "processes on this machine (default: 1, which uses all cores)", metavar="N")


SHOWN = {
    "psnr_head": "head dB",
    "psnr_eyes": "eyes dB",
    "gaze_commanded_deg": "gaze deg",
    "iris_gaze_deg": "iris deg",
    "depth_median_mm": "depth mm",
}
"""Measurements in the table by person, and their headings."""

PAPER_SHOWN = {"gaze_deg": "gaze deg", "head_deg": "head deg", "ssim": "SSIM", "psnr": "dB", "lpips": "LPIPS"}
"""The same for `--protocol paper`."""

METHODS = {
    "bootstrap": "intervals by bootstrap over people",
    "t": "intervals by Student's t over people, who are few",
    "jackknife": "of the Frechet distance by leaving each person out",
    "none": "no interval where there are too few",
}
"""How intervals are said to be made."""


def run(options: Options) -> int:
    """Measure, write the report, print the tables."""
    from gazenerf.checkpoints import BUNDLED
    from gazenerf.cli.common import showing_progress, warn
    from gazenerf.cli.report import current
    from gazenerf.devices import choose_device

    report = current()
    report.choose(field=options.checkpoint or BUNDLED.stem, device=choose_device(options.device))
    where = options.where(1)
    with showing_progress() as progress:
        found: Evaluation | PaperEvaluation
        if options.protocol == "paper":
            found = evaluate_redirection(options, progress, where.workers, where.scheduler)
        else:
            found = evaluate(options, progress, where.workers, where.scheduler)
    for name, why in found.failed.items():
        warn(f"{name}: {why}")
    report.add(*_said(found))
    if not report.for_people:
        return 0
    console = Console()
    if isinstance(found, PaperEvaluation):
        _print_paper(console, found)
    else:
        _print(console, found)
    for name, why in found.left_out.items():
        console.print(f"left out: {name}: {why}", highlight=False)
    console.print(f"wrote {found.file}", highlight=False)
    return 0


def _said(found: Evaluation | PaperEvaluation) -> tuple[list[Path], dict[str, object]]:
    """What was written and measured, for programs."""
    both: dict[str, object] = {"left_out": found.left_out, "failed": found.failed}
    if isinstance(found, PaperEvaluation):
        measurements = {name: estimate.to_dict() for name, estimate in found.measurements.items()}
        return [found.file, found.pairs], {"measurements": measurements, "subjects": found.subjects, **both}
    return [found.file], {"groups": found.groups, "people": found.people, **both}


def _print_paper(console: Console, found: PaperEvaluation) -> None:
    pairs = sum(int(subject["pairs"]) for subject in found.subjects.values())
    table = Table(title=f"{pairs} redirections of {len(found.subjects)} people never trained on")
    for heading in ("measurement", "mean over people", f"{SHARE:.0%} interval"):
        table.add_column(heading, justify="left" if heading == "measurement" else "right")
    for name, estimate in found.measurements.items():
        mean = f"{estimate.mean:.3g} {PAPER_UNITS[name]}".strip()
        table.add_row(_label(name), mean, interval_words(estimate))
    console.print(table)
    methods = {estimate.method for estimate in found.measurements.values()}
    console.print("; ".join(METHODS[method] for method in METHODS if method in methods), highlight=False)
    table = Table(title="by person")
    for heading in ("person", "pairs", *PAPER_SHOWN.values()):
        table.add_column(heading, justify="right")
    for person, values in found.subjects.items():
        numbers = (f"{values[name]:.2f}" if name in values else "-" for name in PAPER_SHOWN)
        table.add_row(person, str(int(values["pairs"])), *numbers)
    console.print(table)


def interval_words(estimate: Estimate) -> str:
    """The ends of an interval, or a dash."""
    return "-" if estimate.low is None or estimate.high is None else f"{estimate.low:.3g} to {estimate.high:.3g}"


def _label(name: str) -> str:
    return name.replace("_deg", "").replace("_mm", "").replace("_", " ")


def _print(console: Console, found: Evaluation) -> None:
    groups = {f"{name} people": found.groups[name] for name in ("trained", "unseen") if found.groups[name]["captures"]}
    table = Table(title="captures never trained on")
    table.add_column("measurement")
    for name, group in groups.items():
        table.add_column(f"{name} ({group['captures']})", justify="right")
    for name, unit in UNITS.items():
        if any(name in group for group in groups.values()):
            cells = [f"{group[name]:.3g} {unit}".strip() if name in group else "-" for group in groups.values()]
            table.add_row(_label(name), *cells)
    console.print(table)
    table = Table(title="by person")
    for heading in ("person", *SHOWN.values()):
        table.add_column(heading, justify="right")
    for person, group in found.people.items():
        table.add_row(person, *(f"{group[name]:.2f}" if name in group else "-" for name in SHOWN))
    console.print(table)
