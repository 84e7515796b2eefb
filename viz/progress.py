"""Progress of long loops, with a rate and an estimate."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TypeVar

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TextColumn, TimeRemainingColumn
from rich.text import Text

T = TypeVar("T")


class RateColumn(ProgressColumn):
    """Steps a second, or seconds a step when that is slower."""

    def __init__(self, unit: str) -> None:
        super().__init__()
        self.unit = unit

    def render(self, task: Task) -> Text:
        """The rate of a task."""
        rate = task.finished_speed or task.speed
        if not rate:
            return Text("")
        return Text(f"{rate:.1f} {self.unit}s/s" if rate >= 1.0 else f"{1.0 / rate:.1f} s/{self.unit}")


def tracked(
    items: Iterable[T], total: int, what: str, unit: str = "frame", console: Console | None = None
) -> Iterator[T]:
    """The items, with a progress line on standard error while they are made.

    Args:
        items: Anything, made as it is asked for.
        total: How many.
        what: What is being done, such as "rendering".
        unit: What one item is, singular.
        console: Where to draw; standard error by default.
    """
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        RateColumn(unit),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console or Console(stderr=True), transient=True) as progress:
        yield from progress.track(items, total=total, description=what)
