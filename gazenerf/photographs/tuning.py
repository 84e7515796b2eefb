"""How long a field is fine-tuned to a person, by which method, and from how many views."""

from __future__ import annotations

from dataclasses import dataclass, replace

METHODS = ("teacher", "paper")
"""`teacher` learns colours from the head model that wears the photograph, the geometry held; `paper` is the paper's
inference: codes and network from the masked photograph alone."""


@dataclass(frozen=True)
class Tuning:
    """What is learned from, and how long.

    Attributes:
        name: Of these settings.
        method: One of `METHODS`.
        around, eye_views: How many views of the teacher are learned from; see `gazenerf.photographs.lessons.lessons`.
        steps: At most.
        check_every: Steps between looks at the held-out views, of the method `teacher`.
        patience: Looks without improvement after which it ends.
    """

    name: str = "default"
    method: str = "teacher"
    around: int = 13
    eye_views: int = 20
    steps: int = 600
    check_every: int = 60
    patience: int = 3

    def for_photographs(self, count: int) -> Tuning:
        """The settings for several photographs of a person, which are learned together: a third more steps for each
        further one, up to twice as many."""
        return replace(self, steps=round(self.steps * min(2.0, 1.0 + (count - 1) / 3.0)))


QUICK = Tuning("quick", around=7, eye_views=7, steps=240)
"""For a first look."""

PAPER = Tuning("paper", "paper", steps=100)
"""The paper gives a time, about a minute on an NVIDIA A40, and no number of steps."""

PAPER_QUICK = Tuning("paper, quick", "paper", steps=30)


def tuning_of(method: str, quick: bool) -> Tuning:
    """The settings of a method.

    Args:
        method: One of `METHODS`.
        quick: Fewer steps.
    """
    if method == "paper":
        return PAPER_QUICK if quick else PAPER
    return QUICK if quick else Tuning()
