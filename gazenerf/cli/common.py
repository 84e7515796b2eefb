"""What commands share: a progress line, one-line warnings and the closing table."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.progress import Progress as ProgressLine
from rich.table import Table

from gazenerf.cli.report import Report, current
from gazenerf.folders import is_remote
from gazenerf.progress import Progress

PROGRESS_VARIABLE = "GAZENERF_PROGRESS"

LINE_SECONDS = 0.3


@contextmanager
def showing_progress(show: bool = True) -> Iterator[Progress]:
    """A progress line on standard error, with rate and time left; quiet when nobody watches or unless `show`.

    A new stage starts the line anew; what follows a comma in its name is a note that may change. Where the environment
    variable `GAZENERF_PROGRESS` is `lines`, every step that is told at least `LINE_SECONDS` after the one before is a
    line `progress: STAGE DONE/TOTAL` instead, for programs that run commands.
    """
    report = current()
    show = show and not report.options.quiet
    if show and os.environ.get(PROGRESS_VARIABLE) == "lines":
        yield _timed(report, _line_teller())
        return
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    console = Console(stderr=True)
    with ProgressLine(*columns, console=console, disable=not (show and sys.stderr.isatty()), transient=True) as bar:
        task = bar.add_task("", total=None, rate="")
        shown = ""

        def tell(stage: str, done: int, total: int, /) -> None:
            nonlocal shown, task
            name = stage.partition(",")[0]
            if name != shown:
                bar.remove_task(task)
                task, shown = bar.add_task(stage, total=total, rate=""), name
            bar.update(task, description=stage, completed=done, total=total)
            speed = bar.tasks[0].speed
            bar.update(task, rate="" if speed is None else f"{speed:.2f}/s")

        yield _timed(report, tell)


def _timed(report: Report, tell: Progress) -> Progress:
    """A progress that also keeps how long each stage took."""
    last = time.perf_counter()

    def timed(stage: str, done: int, total: int, /) -> None:
        nonlocal last
        now = time.perf_counter()
        report.took(stage.partition(",")[0], now - last)
        last = now
        tell(stage, done, total)

    return timed


def _line_teller() -> Progress:
    last = float("-inf")

    def tell(stage: str, done: int, total: int, /) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last >= LINE_SECONDS:
            last = now
            print(f"progress: {' '.join(stage.split())} {done}/{total}", file=sys.stderr, flush=True)

    return tell


def warn(text: str) -> None:
    """Print a one-line warning on standard error."""
    current().warn(text)


def summary_table(
    title: str,
    rows: Mapping[str, object],
    measured: Mapping[str, object] | None = None,
    written: Iterable[Path] = (),
) -> None:
    """Print what was written and measured, or keep it for the JSON object that `--json` asks for.

    Args:
        title: What was done.
        rows: Name to value; a `Path` is something that was written, and is shown with its size where it is a file.
        measured: Name to value, for programs; the rows that are no paths by default.
        written: What was written beside the rows' paths.
    """
    report = current()

    def is_path(value: object) -> bool:
        return isinstance(value, Path) or is_remote(value)

    paths = [value for value in rows.values() if is_path(value)]
    report.add(
        [*paths, *written],
        measured if measured is not None else {k: v for k, v in rows.items() if not is_path(v)},
    )
    if not report.for_people:
        return
    table = Table(title=title, title_justify="left", show_header=False)
    table.add_column(no_wrap=True)
    table.add_column(overflow="fold")
    for name, value in rows.items():
        shown = f"{value} ({file_size(value)})" if isinstance(value, Path) and value.is_file() else str(value)
        table.add_row(name, shown)
    Console(markup=False, highlight=False).print(table)


def file_size(path: Path) -> str:
    """The size of a file for people, in KiB or MiB."""
    size = path.stat().st_size / 1024
    return f"{size:.1f} KiB" if size < 1024 else f"{size / 1024:.1f} MiB"
