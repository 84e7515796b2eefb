"""A person is learned step by step, until nothing is gained or the steps are made."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from gazenerf.photographs.tuning import Tuning
from gazenerf.progress import Progress, silent
from gazenerf.subjects import Codes


class Learner(Protocol):
    """What learns: `gazenerf.photographs.colour_learner` or `gazenerf.photographs.paper_learner`."""

    def step(self, number: int) -> float:
        """Learn, in a way that depends on the number of the step and on nothing that was drawn before. The loss."""
        ...

    def agreement(self) -> float | None:
        """Decibels in views that are not learned from; None where there are none, and all steps are made."""
        ...

    def pictures(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """What is to be seen and what is drawn now, (H, W, 3) float32 sRGB each."""
        ...

    def changes(self) -> dict[str, np.ndarray]:
        """See `gazenerf.personal_weights.PersonalWeights`."""
        ...

    def codes(self) -> list[Codes] | None:
        """Of each photograph; None where they are as they were fitted."""
        ...


@dataclass
class Course:
    """How far the learning is.

    Attributes:
        done: Steps.
        since: Looks since the best one.
        best: Decibels in the held-out views; None where there are none.
        kept: What was learned at the best look, or last.
        codes: The codes then; None where they are held.
    """

    done: int = 0
    since: int = 0
    best: float | None = None
    kept: dict[str, np.ndarray] = field(default_factory=dict)
    codes: list[Codes] | None = None


def learn(
    learner: Learner,
    tuning: Tuning,
    progress: Progress = silent,
    look: Callable[[], None] | None = None,
) -> Course:
    """Learn a person.

    Args:
        learner: Before its first step.
        tuning: How long.
        progress: Told of steps.
        look: Called whenever held-out views are looked at, or after as many steps where there are none.
    """
    course = Course(best=learner.agreement(), kept=learner.changes(), codes=learner.codes())
    while course.done < tuning.steps and course.since < tuning.patience:
        loss = learner.step(course.done)
        course.done += 1
        note = f"loss {loss:.3f}" if course.best is None else f"{course.best:.1f} dB beside the photograph"
        progress(f"learning the person, {note}", course.done, tuning.steps)
        if course.done % tuning.check_every == 0 or course.done == tuning.steps:
            _judge(learner, course)
            if look is not None:
                look()
    return course


def _judge(learner: Learner, course: Course) -> None:
    """Keep what is learned where it is better than what was kept, or nothing can tell."""
    found = learner.agreement()
    better = found is None or course.best is None or found > course.best
    course.since = 0 if better else course.since + 1
    if better:
        course.best, course.kept, course.codes = found, learner.changes(), learner.codes()
