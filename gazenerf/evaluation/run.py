"""An evaluation from its options: captures kept out of training to a report."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gazenerf.checkpoints import load_field
from gazenerf.data import CaptureSet
from gazenerf.data.captures import Capture
from gazenerf.errors import UserError
from gazenerf.evaluation.measuring import EvaluateOptions, Measuring
from gazenerf.evaluation.quality import IRIS_GAZES, UNITS, measurements, summarised
from gazenerf.evaluation.rows import MadeRows
from gazenerf.evaluation.steps import asked, held_out_people, measure_missing, opened
from gazenerf.execution import Where
from gazenerf.execution.job import reason
from gazenerf.files import whole_file
from gazenerf.progress import Progress, silent
from gazenerf.training.split import split_captures


@dataclass(frozen=True)
class Evaluation:
    """A report that was written.

    Attributes:
        file: JSON.
        groups: `all`, `trained`, `unseen` to measurement to value; see `evaluate_field`.
        people: The same by person.
        left_out: Measurement to why it was not made.
        failed: Capture or iris reading that failed to why.
    """

    file: Path
    groups: dict[str, dict[str, Any]]
    people: dict[str, dict[str, Any]]
    left_out: dict[str, str]
    failed: dict[str, str]


def evaluate(
    options: EvaluateOptions, progress: Progress = silent, workers: int = 1, scheduler: str | None = None
) -> Evaluation:
    """Measure a field on captures that training did not see, and write the report.

    Measurements are kept beside the report, in a file that ends in `.rows`, until all are made; the same call goes on
    from them. A capture that cannot be measured is listed in the report, under `failed`.

    Args:
        options: See `EvaluateOptions`.
        progress: Told about captures and iris readings.
        workers: Processes. One uses all cores by threads; a script that asks for more keeps its own work under
            `if __name__ == "__main__":`, because each process imports it.
        scheduler: Address of a Dask scheduler whose workers measure instead; they read the same field.

    Raises:
        UserError: nothing is held out, captures of other code sizes, files that cannot be read, no such device or
            precision, processes died, a cluster is not there, or many captures cannot be measured.
    """
    if options.pairs is not None:
        raise UserError("--pairs is for --protocol paper; leave it out")
    where = Where(workers, scheduler)
    model, captures = opened(options, where, load_field, progress)
    unseen = set(held_out_people(captures, options))
    items = measurements(held_out_captures(captures, options), IRIS_GAZES if options.iris else ())
    made = MadeRows.beside(options.out, asked(options, model, captures))
    job = Measuring(where.placed(options), model.weights_hash)
    failures = measure_missing(job, items, where, made, progress)
    about = {
        "weights_hash": model.weights_hash,
        "field": model.about,
        "data": captures.manifest,
        "unseen_people": sorted(unseen),
        "left_out": made.left_out or {},
        "failed": {name: reason(error) for name, error in sorted(failures.errors.items())},
        "units": UNITS,
    }
    report = summarised([(item.person, row) for item in items for row in made.rows.get(item.name, ())], unseen)
    with whole_file(options.out) as temporary:
        temporary.write_text(json.dumps({**about, **report}, indent=2) + "\n")
    if not failures.errors:
        made.path.unlink()
    groups = {name: report[name] for name in ("all", "trained", "unseen")}
    return Evaluation(options.out, groups, report["people"], about["left_out"], about["failed"])


def held_out_captures(captures: CaptureSet, options: EvaluateOptions) -> list[Capture]:
    """The captures that training did not see, at most `limit` of each person.

    Raises:
        UserError: there are none.
    """
    everything = [captures[i] for i in range(len(captures))]
    _, held = split_captures(everything, options.held_out, options.held_out_views)
    if not held:
        raise UserError("no capture is held out; raise --held-out or --held-out-views")
    chosen: list[Capture] = []
    for person in captures.people:
        own = [capture for capture in held if capture.person == person]
        keep = len(own) if options.limit is None else min(options.limit, len(own))
        chosen += [own[i] for i in np.linspace(0, len(own) - 1, keep).round().astype(int)] if own else []
    return chosen
