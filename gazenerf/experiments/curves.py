"""Errors of estimators that were fitted to people, and their means."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from gazenerf.checkpoints import weights_hash
from gazenerf.evaluation.intervals import Estimate, over_subjects
from gazenerf.experiments.checked import Data
from gazenerf.experiments.options import ExperimentOptions
from gazenerf.experiments.planned import Source
from gazenerf.files import read_json, whole_file

REAL = "real"
"""The method of real pictures alone."""

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


class KeptErrors:
    """Errors that were measured, in a file beside the result, so that a run that was stopped goes on.

    Args:
        options, data, judge: What they depend on.
    """

    def __init__(self, options: ExperimentOptions, data: Data, judge: Source) -> None:
        self._path = options.out / "calibration.rows.json"
        self._about = {
            "data": data.hash, "held_out": options.held_out, "seed": options.seed, "most_real": max(options.real),
            "estimator": weights_hash(judge.file), "samples": options.samples, "steps": options.calibration_steps,
        }  # fmt: skip
        self._errors: dict[str, float] = {}
        if self._path.is_file():
            fix = "delete it"
            there = read_json(self._path, MAX_BYTES, absent=fix, large=fix)
            if isinstance(there, dict) and there.get("about") == self._about and isinstance(there.get("errors"), dict):
                self._errors = {str(name): float(error) for name, error in there["errors"].items()}

    def get(self, method: str, real: int, person: int, measure: Callable[[], float]) -> float:
        """An error that is there, or a new one."""
        name = f"{method}, {real} real, person {person}"
        if name not in self._errors:
            self._errors[name] = float(measure())
            with whole_file(self._path) as temporary:
                temporary.write_text(json.dumps({"about": self._about, "errors": self._errors}) + "\n")
        return self._errors[name]
