"""Which captures a step turns into which: two of the same person, drawn from the seed and the step alone."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from gazenerf.data.captures import Capture
from gazenerf.training.gaze_training import readable


def usable(captures: Sequence[Capture]) -> list[Capture]:
    """Captures that show an eye, of people who have at least two of them."""
    seen = [capture for capture in captures if readable(capture)]
    count = Counter(capture.person for capture in seen)
    return [capture for capture in seen if count[capture.person] > 1]


def draw_pairs(people: Sequence[int], count: int, seed: int, step: int) -> tuple[list[int], list[int]]:
    """Numbers of the first and of the second pictures of a step's pairs.

    Args:
        people: Who is on each picture; everybody is on two at least.
        count: Pairs.
        seed, step: The same give the same pairs.
    """
    rng = np.random.default_rng((seed, 11, step))
    of = np.asarray(people)
    first = rng.integers(0, len(of), count)
    second = [int(rng.choice(np.flatnonzero((of == of[one]) & (np.arange(len(of)) != one)))) for one in first]
    return [int(one) for one in first], second
