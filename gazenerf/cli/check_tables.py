"""What `gazenerf check` prints instead of a measurement: its metrics, and two reports side by side."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console
from rich.table import Column, Table

from gazenerf.cli.report import current, shown
from gazenerf.viz.check.compare import compare_reports
from gazenerf.viz.metrics.families import CHECK_DEFINITIONS, FRAMES_DEFINITIONS
from gazenerf.viz.report.comparison import summary, terminal_rows, write_comparison


def list_metrics() -> int:
    """Print the metrics of both checks, by the names that reports and --fail-on use."""
    families = {"gazenerf check": CHECK_DEFINITIONS, "gazenerf check --frames": FRAMES_DEFINITIONS}
    current().add(
        measured={
            title: [
                {"name": one.name, "unit": one.unit, "higher_is_better": one.higher_is_better, "passes": one.passes,
                 "meaning": one.meaning}
                for one in definitions
            ]
            for title, definitions in families.items()
        }
    )  # fmt: skip
    with shown() as as_text:
        for title, definitions in families.items() if as_text else ():
            table = Table(Column("metric", no_wrap=True), "unit", "passes", "what it says", title=title)
            for one in definitions:
                sign = ">=" if one.higher_is_better else "<="
                table.add_row(one.name, one.unit, f"{sign} {one.passes:g}", one.meaning)
            Console().print(table)
    return 0


def compare(reports: tuple[Path, Path], out: Path | None) -> int:
    """Print how the second of two reports stands to the first, and write the page to a folder where there is one."""
    comparison = compare_reports(*reports)
    page = None if out is None else write_comparison(comparison, out)
    report = current()
    measured = {
        row.a.name: {"first": row.a.value, "second": row.b.value, "change": row.change, "error": row.bar,
                     "second_is": row.judgement}
        for row in comparison.rows
    }  # fmt: skip
    report.add([page] if page else [], {"metrics": measured, "not_made_alike": comparison.differences})
    if not report.for_people:
        return 0
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
    if page is not None:
        console.print(f"page: {page}")
    return 0
