"""An experiment from its options: what is not there yet is trained and measured, then the tables are written."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from gazenerf.errors import UserError
from gazenerf.experiments.calibration import calibrate
from gazenerf.experiments.checked import Data, TestSet, checked_data
from gazenerf.experiments.options import ExperimentOptions
from gazenerf.experiments.pictures import draw_redirections
from gazenerf.experiments.planned import Planned, in_order, refuse_sources
from gazenerf.experiments.results import calibration_result, table_result
from gazenerf.experiments.rows import chosen_rows
from gazenerf.experiments.samples import people_of
from gazenerf.experiments.tasks import Run, Task, check, do, in_a_process
from gazenerf.experiments.written import write_result
from gazenerf.progress import Progress, silent

Say = Callable[[str], None]


@dataclass(frozen=True)
class ExperimentPlan:
    """What an experiment trains and measures.

    Attributes:
        rows: Row to its training.
        measured: Row and name of the captures to its measurement; none of a calibration.
        data: Of the experiment.
        planned: Where its commands are from.
    """

    rows: Mapping[str, Task]
    measured: Mapping[tuple[str, str], Task]
    data: Data
    planned: Planned

    @property
    def tasks(self) -> list[Task]:
        """All of them, in the order in which they are done."""
        return in_order([*self.planned.judge.tasks, *self.rows.values(), *self.measured.values()])

    def lines(self) -> list[tuple[str, bool]]:
        """The command of each, and whether it is done already.

        Raises:
            UserError: something is there that was made with other settings.
        """
        return [(shlex.join(["gazenerf", *task.words]), check(task)) for task in self.tasks]


@dataclass(frozen=True)
class ExperimentResult:
    """Tables that were written.

    Attributes:
        result: What `NAME.json` holds.
        written: Files.
        failed: Row, or row and captures, to why it is missing.
    """

    result: dict[str, Any]
    written: tuple[Path, ...]
    failed: dict[str, str]


def plan_experiment(options: ExperimentOptions) -> ExperimentPlan:
    """What an experiment would train and measure; nothing is trained or written.

    Raises:
        UserError: an unknown experiment, row, preset or setting; captures, pairs or files that do not fit; or models
            in `out` that were trained with other settings.
    """
    names = chosen_rows(options.experiment, options.models)
    calibrates = options.experiment == "calibration"
    data = checked_data(options, partial(people_of, options=options)) if calibrates else checked_data(options)
    planned = Planned(options, data)
    refuse_sources(options, planned.judge)
    rows = {name: planned.training(name) for name in names}
    tests: Sequence[TestSet] = () if calibrates else data.tests
    measured = {(name, test.name): planned.evaluation(rows[name], test) for test in tests for name in names}
    plan = ExperimentPlan(rows, measured, data, planned)
    plan.lines()
    return plan


def run_experiment(
    options: ExperimentOptions, progress: Progress = silent, say: Say = lambda text: None, run: Run = in_a_process
) -> ExperimentResult:
    """Train and measure what is not done yet, and write the tables.

    A row whose training or measurement fails is listed, and the others go on. The same call goes on where one was
    stopped.

    Args:
        options: See `ExperimentOptions`.
        progress: Told about the steps of every command.
        say: Told which command begins, in a line each.
        run: Runs a command.

    Raises:
        UserError: see `plan_experiment`, or the estimator that measures cannot be trained.
    """
    plan = plan_experiment(options)
    failed = _done(plan, run, progress, say)
    for task in plan.planned.judge.tasks:
        if task.record in failed:
            raise UserError(f"the estimator that measures could not be trained: {failed[task.record]}")
    if options.experiment == "calibration":
        able = {row: task for row, task in plan.rows.items() if task.record not in failed}
        found, missing = calibrate(options, plan.data, plan.planned.judge, able, progress, say)
        missing |= {row: failed[task.record] for row, task in plan.rows.items() if task.record in failed}
        result = calibration_result(options, plan.data, plan.planned.judge, plan.rows, found, missing)
    else:
        missing = {
            f"{row} on {name}": failed[task.record]
            for (row, name), task in plan.measured.items()
            if task.record in failed
        }
        result = table_result(options, plan.data, plan.planned.judge, plan.rows, plan.measured, missing)
    written = write_result(result, options.out)
    return ExperimentResult(result, (*written, *_pictures(options, plan, failed)), missing)


def _pictures(options: ExperimentOptions, plan: ExperimentPlan, failed: Mapping[Path, str]) -> list[Path]:
    """Draw what the models that were measured make of some pairs: `NAME.png`, or `cross-SET.png`."""
    able = {row: task for row, task in plan.rows.items() if task.record not in failed}
    written = []
    for test in plan.data.tests if plan.measured and able else ():
        name = options.experiment if test is plan.data.own else f"{options.experiment}-{test.name}"
        written.append(options.out / f"{name}.png")
        draw_redirections(options, test, able, written[-1])
    return written


def _done(plan: ExperimentPlan, run: Run, progress: Progress, say: Say) -> dict[Path, str]:
    """Do every task; the record of each that failed to the reason."""
    failed: dict[Path, str] = {}
    for task in plan.tasks:
        if lacking := [before for before in task.after if before.record in failed]:
            failed[task.record] = f"{lacking[0].name} failed: {failed[lacking[0].record]}"
            continue
        if check(task):
            continue
        say(shlex.join(["gazenerf", *task.words]))
        if why := do(task, run, progress):
            failed[task.record] = why
            say(f"{task.name} failed: {why}")
    return failed
