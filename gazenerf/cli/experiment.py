"""`gazenerf experiment`: a table of the paper from captures."""

from __future__ import annotations

from typing import Any

from gazenerf.experiments.options import ExperimentOptions

HELP = "train and measure what a table of the paper compares, and write the table"

Options = ExperimentOptions


def run(options: ExperimentOptions) -> int:
    """Train and measure what is not there yet, write and print the tables; 1 where a row failed."""
    from gazenerf.cli.common import showing_progress, warn
    from gazenerf.cli.report import current
    from gazenerf.devices import choose_device
    from gazenerf.experiments.run import plan_experiment, run_experiment

    report = current()
    report.choose(experiment=options.experiment, preset=options.preset, device=choose_device(options.device))
    if options.dry_run:
        lines = plan_experiment(options).lines()
        report.add(measured={"plan": [{"command": line, "done": done} for line, done in lines]})
        if report.for_people:
            for line, done in lines:
                print(f"{line}{'    # done' if done else ''}")
        return 0
    with showing_progress() as progress:
        found = run_experiment(options, progress, lambda text: print(text, flush=True))
    report.add(found.written, found.result)
    for name, why in found.failed.items():
        warn(f"{name}: {why}")
    if report.for_people:
        _print(found.result)
        for path in found.written:
            print(f"wrote {path}")
    return 1 if found.failed else 0


def _print(result: dict[str, Any]) -> None:
    """The tables without the paper's numbers, which the files have."""
    from rich.console import Console
    from rich.table import Table

    from gazenerf.experiments.tables import PAPER, tables_of

    console = Console()
    for made in tables_of(result):
        table = Table(title=made.title)
        for number, heading in enumerate(made.headings):
            table.add_column(heading, justify="left" if number == 0 else "right", overflow="fold")
        for row in made.rows:
            if not row.cells[0].startswith(PAPER):
                table.add_row(*row.cells)
        if table.row_count:
            console.print(table)
