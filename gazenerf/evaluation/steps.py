"""The steps that every evaluation has: open the field and its captures, measure what is not measured yet."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any, Protocol, TypeVar

from gazenerf import __version__
from gazenerf.baselines.sted import Sted
from gazenerf.data import CaptureSet
from gazenerf.devices import choose_device, product_dtype
from gazenerf.errors import UserError
from gazenerf.evaluation.measuring import EvaluateOptions, Model, chosen_precision
from gazenerf.evaluation.rows import MadeRows, Rows
from gazenerf.execution import Failures, Job, Where, results
from gazenerf.field.model import TwoStreamField
from gazenerf.options import plain
from gazenerf.progress import Progress, advancing, silent


def opened(
    options: EvaluateOptions, where: Where, load: Callable[[Path | None], Model], progress: Progress = silent
) -> tuple[Model, CaptureSet]:
    """What is measured, and the captures that it is measured on.

    Args:
        options: How.
        where: It is measured.
        load: Reads `options.checkpoint`.
        progress: Told of files that are fetched.

    Raises:
        UserError: files that cannot be read, captures of other code sizes, or no such device, precision or limit.
    """
    if options.limit is not None and options.limit < 1:
        raise UserError(f"--limit must be at least 1, got {options.limit}")
    if where.scheduler is None:
        product_dtype(chosen_precision(options, device := choose_device(options.device)), device)
    model, captures = load(options.checkpoint), CaptureSet(options.data, progress)
    if isinstance(model, TwoStreamField) and captures[0].codes.sizes != model.config.code_sizes:
        raise UserError(f"the captures' codes are {captures[0].codes.sizes}, the field takes {model.config.code_sizes}")
    return model, captures


def held_out_people(captures: CaptureSet, options: EvaluateOptions) -> list[int]:
    """The people of whom training saw no capture."""
    people = captures.people
    return people[len(people) - options.held_out :] if options.held_out > 0 else []


def asked(options: EvaluateOptions, model: TwoStreamField | Sted, captures: CaptureSet) -> dict[str, Any]:
    """What rows depend on beside the captures that are chosen."""
    names = "data", "gaze_estimator", "iris", "device", "precision"
    return {
        "version": __version__,
        "weights_hash": model.weights_hash,
        "captures": captures.manifest,
        **{name: plain(getattr(options, name)) for name in names},
    }


class Named(Protocol):
    """Something to measure."""

    @property
    def name(self) -> str:
        """Unique among what is measured."""
        ...


Item = TypeVar("Item", bound=Named)


def measure_missing(
    job: Job[Item, tuple[Rows, dict[str, str]]],
    items: Sequence[Item],
    where: Where,
    made: MadeRows,
    progress: Progress,
) -> Failures:
    """Measure what is not measured yet.

    Raises:
        UserError: many measurements fail, or all, or the place is gone.
    """
    left = [item for item in items if item.name not in made.rows]
    advance = advancing(progress, "measuring", len(items) - len(left), len(items))
    failures = Failures("measurement", "measurements", "goes on")
    with closing(results(job, left, where, advance=advance)) as every:
        for done in every:
            if done.error is None:
                made.add(done.item.name, *done.result)
            elif failures.add(done.item.name, done.error):
                failures.refuse()
    if not made.rows:
        failures.refuse()
    return failures
