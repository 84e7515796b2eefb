"""Redirected pictures of an experiment's rows beside the true ones, one pair of each person."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from gazenerf.data import CaptureSet
from gazenerf.data.captures import Capture
from gazenerf.evaluation.measuring import EvaluateOptions
from gazenerf.evaluation.redirectors import Redirector, load_model, open_redirector
from gazenerf.experiments.checked import TestSet
from gazenerf.experiments.figure import draw_pictures
from gazenerf.experiments.options import ExperimentOptions
from gazenerf.experiments.tasks import Task
from gazenerf.heads.cutouts import over

WHITE = (255, 255, 255)
MOST_PEOPLE = 6


def model_redirector(options: ExperimentOptions, training: Task) -> Redirector:
    """What a trained model redirects with.

    Raises:
        UserError: it cannot be read, or there is no such device.
    """
    asked = EvaluateOptions(data=options.data, out=options.out, checkpoint=training.made, device=options.device)
    return open_redirector(asked, load_model(training.made).weights_hash)


def draw_redirections(options: ExperimentOptions, test: TestSet, models: Mapping[str, Task], path: Path) -> None:
    """Draw the first pair of each of some people: source, target, and the source as each model redirects it.

    Args:
        options: Of the experiment.
        test: Whose pairs.
        models: Name to its training.
        path: `.png`.

    Raises:
        UserError: a model cannot be read, or the folder cannot be written.
    """
    captures = {(capture.person, capture.view): capture for capture in CaptureSet(test.data)}
    pairs = test.pairs.first(1)[:MOST_PEOPLE]
    sources = [captures[pair.person, pair.source] for pair in pairs]
    targets = [captures[pair.person, pair.target] for pair in pairs]
    columns = {"source": [_alone(capture) for capture in sources], "target": [_alone(capture) for capture in targets]}
    for name, training in models.items():
        redirector = model_redirector(options, training)
        columns[name] = [
            over(redirector.redirect(source, target), WHITE) for source, target in zip(sources, targets, strict=True)
        ]
    draw_pictures(columns, path)


def _alone(capture: Capture) -> np.ndarray:
    """A capture's head on white, (H, W, 3) in [0, 1]."""
    return np.where(capture.head_mask[..., None], capture.image, np.uint8(255)) / 255.0
