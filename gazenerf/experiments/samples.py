"""The pictures that an estimator is fitted to a person with, and those that it is measured on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gazenerf.data.captures import Capture
from gazenerf.errors import UserError
from gazenerf.evaluation.redirectors import Redirector
from gazenerf.experiments.options import ExperimentOptions
from gazenerf.heads.cutouts import over
from gazenerf.training.gaze_training import readable

BLACK = (0, 0, 0)
LEAST_TESTED = 3
"""Pictures of a person that have to be left to measure on."""


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
