"""`gazenerf evaluate`: quality of a field on views, gazes and people that it has not seen."""

from __future__ import annotations

from dataclasses import dataclass

from rich.console import Console
from rich.table import Table

from gazenerf.evaluation.quality import UNITS
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
        found = evaluate(options, progress, where.workers, where.scheduler)
    for name, why in found.failed.items():
        warn(f"{name}: {why}")
    names = "groups", "people", "left_out", "failed"
    report.add([found.file], {name: getattr(found, name) for name in names})
    if not report.for_people:
        return 0
    console = Console()
    _print(console, found)
    for name, why in found.left_out.items():
        console.print(f"left out: {name}: {why}", highlight=False)
    console.print(f"wrote {found.file}", highlight=False)
    return 0


def _print(console: Console, found: Evaluation) -> None:
    groups = {f"{name} people": found.groups[name] for name in ("trained", "unseen") if found.groups[name]["captures"]}
    table = Table(title="captures never trained on")
    table.add_column("measurement")
    for name, group in groups.items():
        table.add_column(f"{name} ({group['captures']})", justify="right")
    for name, unit in UNITS.items():
        if any(name in group for group in groups.values()):
            label = name.replace("_deg", "").replace("_mm", "").replace("_", " ")
            cells = [f"{group[name]:.3g} {unit}".strip() if name in group else "-" for group in groups.values()]
            table.add_row(label, *cells)
    console.print(table)
    table = Table(title="by person")
    for heading in ("person", *SHOWN.values()):
        table.add_column(heading, justify="right")
    for person, group in found.people.items():
        table.add_row(person, *(f"{group[name]:.2f}" if name in group else "-" for name in SHOWN))
    console.print(table)
