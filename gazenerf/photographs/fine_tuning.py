"""A person is learned step by step, until nothing is gained or the steps are made; a run that was cut short goes on."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
import torch

from gazenerf.photographs.state_file import StateFile
from gazenerf.photographs.tuning import Tuning
from gazenerf.progress import Progress, silent
from gazenerf.subjects import Codes

SAVE_SECONDS = 20.0
"""Between two states that are written."""

Pictures = list[tuple[np.ndarray, np.ndarray]]
"""What is to be seen and what is drawn, (H, W, 3) float32 sRGB each."""


class Learner(Protocol):
    """What learns: `gazenerf.photographs.colour_learner` or `gazenerf.photographs.paper_learner`."""

    def step(self, number: int) -> float:
        """Learn, in a way that depends on the number of the step and on nothing that was drawn before. The loss."""
        ...

    def agreement(self) -> float | None:
        """Decibels in views that are not learned from; None where there are none, and all steps are made."""
        ...

    def pictures(self) -> Pictures:
        """What is to be seen and what is drawn now."""
        ...

    def changes(self) -> dict[str, np.ndarray]:
        """See `gazenerf.personal_weights.PersonalWeights`."""
        ...

    def codes(self) -> list[Codes] | None:
        """Of each photograph; None where they are as they were fitted."""
        ...

    def state(self) -> dict[str, Any]:
        """Everything that the next steps depend on, as tensors and plain values."""
        ...

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from what `state` gave; KeyError, TypeError, ValueError or RuntimeError where it is of no use."""
        ...


@dataclass(frozen=True)
class Preview:
    """Pictures of how far the learning is.

    Attributes:
        show: Is given them.
        seconds: Between two times.
    """

    show: Callable[[Pictures], None]
    seconds: float = 20.0


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

    def state(self) -> dict[str, Any]:
        """As tensors and plain values."""
        codes = None if self.codes is None else [[torch.from_numpy(v) for v in _codes(item)] for item in self.codes]
        kept = {name: torch.from_numpy(value) for name, value in self.kept.items()}
        return {"done": self.done, "since": self.since, "best": self.best, "kept": kept, "codes": codes}

    @classmethod
    def of(cls, state: Mapping[str, Any]) -> Course:
        """What `state` gave."""
        codes, best = state["codes"], state["best"]
        return cls(
            int(state["done"]),
            int(state["since"]),
            None if best is None else float(best),
            {str(name): value.numpy() for name, value in state["kept"].items()},
            None if codes is None else [Codes(*(value.numpy() for value in item)) for item in codes],
        )


def _codes(codes: Codes) -> tuple[np.ndarray, ...]:
    return codes.identity, codes.expression, codes.texture, codes.illumination


class _Every:
    """Whether so many seconds have passed since it was last so."""

    def __init__(self, seconds: float, at_once: bool) -> None:
        self.seconds, self.last = seconds, float("-inf") if at_once else time.monotonic()

    def due(self) -> bool:
        now = time.monotonic()
        if now - self.last < self.seconds:
            return False
        self.last = now
        return True


def learn(
    learner: Learner,
    tuning: Tuning,
    progress: Progress = silent,
    state: StateFile | None = None,
    preview: Preview | None = None,
) -> Course:
    """Learn a person.

    Args:
        learner: Before its first step.
        tuning: How long.
        progress: Told of steps.
        state: Where it is kept how far the learning is, and where it goes on from.
        preview: Shown after the first step, then every so many seconds.

    Raises:
        UserError: the state is damaged.
    """
    course = _begun(learner, state)
    save, show = _Every(SAVE_SECONDS, False), _Every(0.0 if preview is None else preview.seconds, True)
    while course.done < tuning.steps and course.since < tuning.patience:
        loss = learner.step(course.done)
        course.done += 1
        if course.done % tuning.check_every == 0 or course.done == tuning.steps:
            _judge(learner, course)
        if state is not None and save.due():
            state.keep({"course": course.state(), "learner": learner.state()})
        if preview is not None and show.due():
            preview.show(learner.pictures())
        note = f"loss {loss:.3f}" if course.best is None else f"{course.best:.1f} dB beside the photograph"
        progress(f"learning the person, {note}", course.done, tuning.steps)
    return course


def _begun(learner: Learner, state: StateFile | None) -> Course:
    """Where the learning is: at its beginning, or where it was cut short."""
    kept = None if state is None else state.kept()
    if state is None or kept is None:
        return Course(best=learner.agreement(), kept=learner.changes(), codes=learner.codes())
    try:
        course = Course.of(kept["course"])
        learner.restore(kept["learner"])
    except (KeyError, TypeError, ValueError, RuntimeError, AttributeError) as error:
        raise state.damaged(error) from error
    return course


def _judge(learner: Learner, course: Course) -> None:
    """Keep what is learned where it is better than what was kept, or nothing can tell."""
    found = learner.agreement()
    better = found is None or course.best is None or found > course.best
    course.since = 0 if better else course.since + 1
    if better:
        course.best, course.kept, course.codes = found, learner.changes(), learner.codes()
