"""`gazenerf evaluate`: quality of a field on views, gazes and people that it has not seen."""

from __future__ import annotations

from rich.console import Console
from rich.table import Table

from gazenerf.evaluation.quality import UNITS
from gazenerf.evaluation.run import EvaluateOptions, Evaluation, evaluate

HELP = "measure a field on views, gazes and people it has not seen"

Options = EvaluateOptions

SHOWN = {
    "psnr_head": "head dB",
    "psnr_eyes": "eyes dB",
    "gaze_commanded_deg": "gaze deg",
    "iris_gaze_deg": "iris deg",
    "depth_median_mm": "depth mm",
}
"""Measurements in the table by person, and their headings."""


def run(options: EvaluateOptions) -> int:
    """Measure, write the report, print the tables."""
    from gazenerf.checkpoints import BUNDLED
    from gazenerf.cli.common import showing_progress
    from gazenerf.cli.report import current
    from gazenerf.devices import choose_device

    report = current()
    report.choose(field=options.checkpoint or BUNDLED.stem, device=choose_device(options.device))
    with showing_progress() as progress:
        found = evaluate(options, progress)
    report.add([found.file], {"groups": found.groups, "people": found.people, "left_out": found.left_out})
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
