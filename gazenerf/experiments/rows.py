"""The paper's experiments: which rows each has, and in which training a row is learned."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from gazenerf.errors import UserError
from gazenerf.experiments.published import published
from gazenerf.names import did_you_mean
from gazenerf.training.models import LADDER, MODELS, STED

STARTED = "gazenerf-from-headnerf"
"""The row, and the training, of a GazeNeRF that starts from a HeadNeRF."""

TRAININGS = (STED, *(name for name in MODELS), *LADDER, STARTED)
"""Every training there can be, by name. Of two with equal settings the earlier one is trained, and serves both."""

COMPARED = (STED, "headnerf", "gazenerf")


@dataclass(frozen=True)
class Experiment:
    """A table or a figure of the paper.

    Attributes:
        line: What it compares.
        rows: Names, in the paper's order; a row's name is that of its training.
    """

    line: str
    rows: tuple[str, ...]


EXPERIMENTS = {
    "within": Experiment("models against each other on people held out of the captures", COMPARED),
    "cross": Experiment("the same models on other data sets", COMPARED),
    "ablation": Experiment(
        "one stream or two, with rotation or without, with the functional loss or without",
        ("vanilla", "vanilla+rotation", "two-stream", "two-stream+rotation", "vanilla+functional", "gazenerf"),
    ),
    "losses": Experiment("losses added one after the other", tuple(LADDER)),
    "pretrained": Experiment("from scratch, and from a HeadNeRF", ("gazenerf", STARTED)),
    "calibration": Experiment("a gaze estimator fitted to a person with few pictures, and redirected ones", COMPARED),
}
"""Name to what it is."""


def chosen_rows(experiment: str, models: Sequence[str]) -> tuple[str, ...]:
    """The rows of an experiment that are asked for, in its order; all where none is named.

    Raises:
        UserError: there is no such experiment, or it has no such row.
    """
    if experiment not in EXPERIMENTS:
        meant = did_you_mean(experiment, EXPERIMENTS)
        raise UserError(f"unknown experiment {experiment!r}{meant}; there are {', '.join(EXPERIMENTS)}")
    rows = EXPERIMENTS[experiment].rows
    if strange := [name for name in models if name not in rows]:
        meant = did_you_mean(strange[0], rows)
        raise UserError(f"--models {strange[0]}: {experiment} has no such row{meant}; there are {', '.join(rows)}")
    return tuple(row for row in rows if not models or row in models)


def title_of(experiment: str, row: str) -> str:
    """What the paper calls a row."""
    titles = published()["within" if experiment == "calibration" else experiment].titles
    return titles[row]
