"""A gaze estimator fitted to a person with a few pictures, and with pictures that a model redirected from them.

The paper's supplementary, "Personal calibration for gaze estimation": of each person a few real pictures, filled up
with redirected ones to a fixed number, fine-tune the estimator, which is then measured on that person's other pictures.
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from gazenerf.data import CaptureSet
from gazenerf.data.captures import Capture
from gazenerf.errors import UserError
from gazenerf.evaluation.intervals import Estimate, over_subjects
from gazenerf.evaluation.measuring import EvaluateOptions
from gazenerf.evaluation.redirectors import Redirector, load_model, open_redirector
from gazenerf.experiments.checked import Data
from gazenerf.experiments.fitted_estimator import FittedEstimator, open_estimator
from gazenerf.experiments.options import ExperimentOptions
from gazenerf.experiments.planned import Source
from gazenerf.experiments.tasks import Task
from gazenerf.files import read_json, whole_file
from gazenerf.heads.cutouts import over
from gazenerf.progress import Progress
from gazenerf.training.gaze_training import readable
from gazenerf.training.split import split_captures

BLACK = (0, 0, 0)
LEAST_TESTED = 3
"""Pictures of a person that have to be left to measure on."""

REAL = "real"
MAX_BYTES = 16 * 2**20


@dataclass
class Curves:
    """Errors of estimators that were fitted to people.

    Attributes:
        errors: Method, number of real pictures and person to mean degrees on the person's other pictures.
        untouched: Person to the same of the estimator as it was.
        test_pictures: Person to how many those are.
    """

    errors: dict[str, dict[int, dict[int, float]]] = field(default_factory=dict)
    untouched: dict[int, float] = field(default_factory=dict)
    test_pictures: dict[int, int] = field(default_factory=dict)

    @property
    def people(self) -> int:
        """How many were measured."""
        return len(self.untouched)

    @property
    def before(self) -> Estimate:
        """The error before any calibration, degrees."""
        return over_subjects(list(self.untouched.values()))

    def of(self, method: str) -> dict[str, Any]:
        """A method's `errors` by number of real pictures, and `gains`: how much smaller they are than with the real
        pictures alone, person by person, degrees."""
        own, real = self.errors.get(method, {}), self.errors.get(REAL, {})
        found = {"errors": {str(k): over_subjects(list(by.values())).to_dict() for k, by in sorted(own.items())}}
        if method != REAL:
            found["gains"] = {
                str(k): over_subjects([real[k][person] - error for person, error in by.items()]).to_dict()
                for k, by in sorted(own.items())
            }
        return found


@dataclass(frozen=True)
class Person:
    """Somebody whom the estimator is fitted to.

    Attributes:
        number: Index.
        real: Pictures to fit with, the first ones first.
        tested: Pictures to measure on.
    """

    number: int
    real: tuple[Capture, ...]
    tested: tuple[Capture, ...]


def calibrate(
    options: ExperimentOptions,
    data: Data,
    judge: Source,
    models: Mapping[str, Task],
    progress: Progress,
    say: Any = lambda text: None,
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
            redirector = None if method == REAL else _redirector(options, models[method])
            curves.errors[method] = _curve(
                method, redirector, models.get(method), people, targets, estimator, options, kept, progress
            )
        except UserError as error:
            failed[method] = str(error)
    return curves, failed


def people_of(captures: Sequence[Capture], options: ExperimentOptions) -> list[Person]:
    """The people who were held out, their readable pictures in an order drawn from the seed.

    Raises:
        UserError: one has too few of them.
    """
    numbers = sorted({capture.person for capture in captures})[-options.held_out :]
    most, found = max(options.real), []
    for number in numbers:
        own = [capture for capture in captures if capture.person == number and readable(capture)]
        if len(own) < most + LEAST_TESTED:
            raise UserError(
                f"person {number} has {len(own)} pictures that show an eye; {most} real ones (--real) and "
                f"{LEAST_TESTED} to measure on are needed"
            )
        order = np.random.default_rng((options.seed, 29, number)).permutation(len(own))
        shuffled = [own[i] for i in order]
        found.append(Person(number, tuple(shuffled[:most]), tuple(shuffled[most:])))
    return found


def _redirector(options: ExperimentOptions, task: Task) -> Redirector:
    asked = EvaluateOptions(data=options.data, out=options.out, checkpoint=task.made, device=options.device)
    return open_redirector(asked, load_model(task.made).weights_hash)


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
    key = method if task is None else f"{method} {task.digest}"
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


class Samples:
    """Pictures to fit an estimator with: real ones, and redirected ones until there are enough.

    A redirected picture has the codes of a real one, and gaze and camera of a capture of somebody whom training saw,
    drawn from the seed. Which real one it starts from changes as little as can be while more of them are used.

    Args:
        person: Whose.
        redirector: None gives real pictures alone.
        targets: Captures to take gaze and camera from.
        options: Of the experiment.
    """

    def __init__(
        self, person: Person, redirector: Redirector | None, targets: Sequence[Capture], options: ExperimentOptions
    ) -> None:
        self.person, self._redirector, self._targets, self._options = person, redirector, targets, options
        self._made: dict[tuple[int, int], Capture] = {}

    def of(self, real: int) -> list[Capture]:
        """So many real pictures, and redirected ones of them."""
        pictures = list(self.person.real[:real])
        if self._redirector is None:
            return pictures
        return pictures + [self._redirected(self._source(i, real), i) for i in range(self._options.samples - real)]

    def _source(self, sample: int, real: int) -> int:
        """Which of the real pictures a redirected one starts from; each is as likely as the others."""
        draws = np.random.default_rng((self._options.seed, 37, self.person.number, sample)).random(real)
        return int(draws.argmin())

    def _redirected(self, source: int, sample: int) -> Capture:
        if (source, sample) not in self._made:
            rng = np.random.default_rng((self._options.seed, 31, self.person.number, sample))
            target = self._targets[int(rng.integers(len(self._targets)))]
            self._made[source, sample] = redirected(self._redirector, self.person.real[source], target)
        return self._made[source, sample]


def redirected(redirector: Redirector | None, source: Capture, target: Capture) -> Capture:
    """A capture of the source's person, light and expression with gaze and camera of the target.

    Its `parts` say where the target shows eyes, and else that all is face: nobody knows where the made head ends.
    """
    assert redirector is not None
    aim = replace(
        target, codes=source.codes, parts=np.maximum(target.parts, 1), person=source.person, view=source.view
    )  # fmt: skip
    made = over(redirector.redirect(source, aim), BLACK)
    return replace(aim, image=np.round(255.0 * np.clip(made, 0.0, 1.0)).astype(np.uint8))


class KeptErrors:
    """Errors that were measured, in a file beside the result, so that a run that was stopped goes on.

    Args:
        options, data, judge: What they depend on.
    """

    def __init__(self, options: ExperimentOptions, data: Data, judge: Source) -> None:
        self._path = options.out / "calibration.rows.json"
        self._about = {
            "data": data.hash, "estimator": judge.identity, "held_out": options.held_out, "seed": options.seed,
            "most_real": max(options.real), "samples": options.samples, "steps": options.calibration_steps,
        }  # fmt: skip
        self._errors: dict[str, float] = {}
        if self._path.is_file():
            fix = "delete it"
            there = read_json(self._path, MAX_BYTES, absent=fix, large=fix)
            if isinstance(there, dict) and there.get("about") == self._about and isinstance(there.get("errors"), dict):
                self._errors = {str(name): float(error) for name, error in there["errors"].items()}

    def get(self, method: str, real: int, person: int, measure: Any) -> float:
        """An error that is there, or a new one."""
        name = f"{method}, {real} real, person {person}"
        if name not in self._errors:
            self._errors[name] = float(measure())
            with whole_file(self._path) as temporary:
                temporary.write_text(json.dumps({"about": self._about, "errors": self._errors}) + "\n")
        return self._errors[name]
