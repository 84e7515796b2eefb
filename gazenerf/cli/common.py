"""What commands share: source and gaze arguments, a progress line, one-line warnings and the closing table."""

from __future__ import annotations

import argparse
import math
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

from gazenerf.errors import UserError

if TYPE_CHECKING:
    from gazenerf.geometry import Gaze
    from gazenerf.heads.interface import BoundField
    from gazenerf.subjects import Subject


def add_source_arguments(parser: argparse.ArgumentParser) -> None:
    """Add --subject and --checkpoint, both defaulting to what is bundled."""
    parser.add_argument(
        "--subject",
        metavar="S",
        help="a bundled name or a subject file (default: the first bundled; see `gazenerf subjects`)",
    )
    parser.add_argument("--checkpoint", type=Path, metavar="FILE", help="weights (default: the bundled field)")


def add_gaze_argument(parser: argparse.ArgumentParser) -> None:
    """Add --gaze PITCH YAW in degrees, straight ahead by default."""
    parser.add_argument(
        "--gaze",
        nargs=2,
        type=float,
        default=(0.0, 0.0),
        metavar=("PITCH", "YAW"),
        help="where the eyes look, degrees: pitch up, yaw to the subject's left (default: 0 0)",
    )


def checked_gaze(angles: tuple[float, float] | list[float]) -> Gaze:
    """A gaze from (pitch, yaw) in degrees.

    Raises:
        UserError: an angle is not finite, or 90 degrees or more.
    """
    from gazenerf.geometry import Gaze

    pitch, yaw = angles
    if not all(math.isfinite(angle) and abs(angle) < 90.0 for angle in (pitch, yaw)):
        raise UserError(f"--gaze {pitch:g} {yaw:g}: both angles must lie between -90 and 90 degrees")
    return Gaze.from_degrees(pitch, yaw)


def load_bound_factory(args: argparse.Namespace) -> tuple[Subject, Callable[[Gaze], BoundField]]:
    """The subject that the arguments name and a function that binds it to a gaze.

    Binding warns once when a gaze is beyond what the field was trained on.

    Raises:
        UserError: the field or the subject cannot be read or do not fit, or nothing is bundled.
    """
    from gazenerf.cli.views import beyond_training, binder, load_scene

    field, subject = load_scene(args)
    quietly = binder(field, subject)
    warned = False

    def bind(gaze: Gaze) -> BoundField:
        nonlocal warned
        if not warned and (note := beyond_training(field, [gaze])):
            warned = True
            warnings.warn(note, stacklevel=2)
        return quietly(gaze)

    return subject, bind


@contextmanager
def progress(title: str, total: int, show: bool = True) -> Iterator[Callable[..., None]]:
    """A progress line on standard error, with rate and time left; quiet when nobody watches or unless `show`.

    Yields:
        A function `advance(steps, note="", total=None)`; a total replaces the one before.
    """
    console = Console(stderr=True)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
        TextColumn("{task.fields[note]}"),
    )
    with Progress(*columns, console=console, disable=not (show and sys.stderr.isatty()), transient=True) as bar:
        task = bar.add_task(title, total=total, rate="", note="")

        def advance(steps: int = 1, note: str = "", total: int | None = None) -> None:
            bar.update(task, advance=steps, note=note, total=total)
            speed = bar.tasks[0].speed
            bar.update(task, rate="" if speed is None else f"{speed:.2f}/s")

        yield advance


def summary_table(title: str, rows: Mapping[str, object]) -> None:
    """Print what was written and measured.

    Args:
        title: What was done.
        rows: Name to value; a `Path` that exists is shown with its size.
    """
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
