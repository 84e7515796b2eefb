"""A gaze estimator fitted to a person with a few pictures, and with pictures that a model redirected from them.

The paper's supplementary, "Personal calibration for gaze estimation": of each person a few real pictures, filled up
with redirected ones to a fixed number, fine-tune the estimator, which is then measured on that person's other pictures.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping, Sequence
from functools import partial

from gazenerf.checkpoints import weights_hash
from gazenerf.data import CaptureSet
from gazenerf.data.captures import Capture
from gazenerf.errors import UserError
from gazenerf.evaluation.redirectors import Redirector
from gazenerf.experiments.checked import Data
from gazenerf.experiments.curves import REAL, Curves, KeptErrors
from gazenerf.experiments.fitted_estimator import FittedEstimator, open_estimator
from gazenerf.experiments.options import ExperimentOptions
from gazenerf.experiments.pictures import model_redirector
from gazenerf.experiments.planned import Source
from gazenerf.experiments.samples import Person, Samples, people_of
from gazenerf.experiments.tasks import Task
from gazenerf.progress import Progress
from gazenerf.training.gaze_training import readable
from gazenerf.training.split import split_captures


def calibrate(
    options: ExperimentOptions,
    data: Data,
    judge: Source,
    models: Mapping[str, Task],
    progress: Progress,
    say: Callable[[str], None] = lambda text: None,
) -> tuple[Curves, dict[str, str]]:
    """The curves of real pictures alone and of each model; and model to why it has none.

    Errors are kept in `calibration.rows.json` as they are made, and not made again.

    Raises:
        UserError: people with too few pictures.
    """
    captures = CaptureSet(options.data)
    learned, _ = split_captures(captures, options.held_out, 0.0)
    targets = [capture for capture in learned if readable(capture)]
    people = people_of(captures, options)
    estimator = open_estimator(judge.file, options.device)
    kept = KeptErrors(options, data, judge)
    curves, failed = Curves(), dict[str, str]()
    for person in people:
        measure = partial(estimator.error, person.tested)
        curves.test_pictures[person.number] = len(person.tested)
        curves.untouched[person.number] = kept.get("before", 0, person.number, measure)
    for method in (REAL, *models):
        say(f"calibration with {method} samples")
        try:
            redirector = None if method == REAL else model_redirector(options, models[method])
            curves.errors[method] = _curve(
                method, redirector, models.get(method), people, targets, estimator, options, kept, progress
            )
        except UserError as error:
            failed[method] = str(error)
    return curves, failed


def _curve(
    method: str,
    redirector: Redirector | None,
    task: Task | None,
    people: Sequence[Person],
    targets: Sequence[Capture],
    estimator: FittedEstimator,
    options: ExperimentOptions,
    kept: KeptErrors,
    progress: Progress,
) -> dict[int, dict[int, float]]:
    """Number of real pictures and person to error."""
    found: dict[int, dict[int, float]] = {real: {} for real in options.real}
    total, done = len(people) * len(options.real), 0
    key = method if task is None else f"{method} {weights_hash(task.made)}"
    for person in people:
        samples = Samples(person, redirector, targets, options)
        for real in options.real:
            measure = partial(_fitted_error, estimator, samples, real, options)
            found[real][person.number] = kept.get(key, real, person.number, measure)
            done += 1
            progress(f"calibration with {method} samples", done, total)
    return found


def _fitted_error(estimator: FittedEstimator, samples: Samples, real: int, options: ExperimentOptions) -> float:
    person = samples.person
    seed = zlib.crc32(f"{options.seed} {person.number} {real}".encode())
    return estimator.fitted(samples.of(real), options.calibration_steps, seed).error(person.tested)
