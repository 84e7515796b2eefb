"""The paper's evaluation from its options: pairs of captures of held-out people to a report with intervals."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gazenerf.data import CaptureSet
from gazenerf.errors import UserError
from gazenerf.evaluation.frechet import load_features
from gazenerf.evaluation.identity import identity_name, load_identity
from gazenerf.evaluation.intervals import Estimate
from gazenerf.evaluation.measuring import EvaluateOptions, gaze_reader, optional
from gazenerf.evaluation.pairs import Pair, Pairs, draw_pairs, load_pairs, save_pairs
from gazenerf.evaluation.paper_summary import summarised
from gazenerf.evaluation.redirection import UNITS, PaperInstruments, Redirection, measure_redirection
from gazenerf.evaluation.redirectors import load_model, open_redirector
from gazenerf.evaluation.rows import MadeRows, Rows
from gazenerf.evaluation.steps import asked, held_out_people, measure_missing, opened
from gazenerf.execution import Tell, Where
from gazenerf.execution.job import reason
from gazenerf.files import whole_file
from gazenerf.geometry.labels import check_radians
from gazenerf.head_model import load_head_model
from gazenerf.progress import Progress, silent
from gazenerf.training.estimators import estimator_name
from gazenerf.training.perceptual import load_lpips

CODES = {"identity": "source", "texture": "source", "expression": "target", "illumination": "target"}


@dataclass(frozen=True)
class PaperEvaluation:
    """A report that was written.

    Attributes:
        file: JSON.
        pairs: The file of pairs, drawn now or before.
        measurements: Name to its mean over subjects with an interval.
        subjects: Person to the number of pairs and each measurement's mean.
        left_out: Measurement to why it was not made.
        failed: Pair to why it could not be measured.
    """

    file: Path
    pairs: Path
    measurements: dict[str, Estimate]
    subjects: dict[str, dict[str, float]]
    left_out: dict[str, str]
    failed: dict[str, str]


@dataclass(frozen=True)
class Redirecting:
    """The job of redirecting and measuring; gives rows, and why what is left out is.

    Attributes:
        options: How.
        weights_hash: Of the field or the STED.
    """

    options: EvaluateOptions
    weights_hash: str

    @contextlib.contextmanager
    def opened(self) -> Iterator[Callable[[Redirection, Tell], tuple[Rows, dict[str, str]]]]:
        """Load what redirects and what measures."""
        left_out: dict[str, str] = {}
        redirector = open_redirector(self.options, self.weights_hash)
        instruments = _instruments(self.options, left_out)
        yield lambda item, _: (measure_redirection(redirector, item, instruments), left_out)


def _instruments(options: EvaluateOptions, left_out: dict[str, str]) -> PaperInstruments:
    """What can measure here; why something cannot is put into `left_out`."""
    if options.identity_model is not None:
        embed = load_identity(options.identity_model)
    else:
        embed = optional(left_out, "identity similarity", load_identity)
    return PaperInstruments(
        gaze_reader(options, left_out),
        optional(left_out, "LPIPS", lambda: load_lpips("vgg16")),
        optional(left_out, "Frechet distance", lambda: load_features(left_out)),
        embed,
        load_head_model(),
    )


def evaluate_redirection(
    options: EvaluateOptions, progress: Progress = silent, workers: int = 1, scheduler: str | None = None
) -> PaperEvaluation:
    """Redirect captures of people that training did not see to others of theirs, and write the report.

    What is measured is kept beside the report until all is, as `gazenerf.evaluation.run.evaluate` does, and a pair that
    cannot be measured is listed under `failed`.

    Args:
        options: See `EvaluateOptions`; `pairs` must be given.
        progress: Told about pairs.
        workers, scheduler: As of `evaluate`.

    Raises:
        UserError: no pairs file is named or it is of other data, nobody is held out, gazes that cannot be radians, or
            what `evaluate` raises.
    """
    where = Where(workers, scheduler)
    model, captures = opened(options, where, load_model, progress)
    pairs = chosen_pairs(options, captures)
    items = [_item(pair, captures) for pair in pairs.first(options.limit)]
    by = {
        "estimator": estimator_name(options.gaze_estimator),
        "identity_model": identity_name(options.identity_model),
        "pairs": pairs.hash,
    }
    made = MadeRows.beside(options.out, asked(options, model, captures) | by)
    failures = measure_missing(Redirecting(where.placed(options), model.weights_hash), items, where, made, progress)
    rows = [(item.person, row) for item in items for row in made.rows.get(item.name, ())]
    measurements, subjects = summarised(rows)
    report = {
        "protocol": "paper",
        "weights_hash": model.weights_hash,
        "field": model.about,
        "data": captures.manifest,
        "pairs": {"file": str(options.pairs), "hash": pairs.hash, "data": pairs.data, "seed": pairs.seed,
                  "measured": len(rows)},
        "codes": CODES,
        "estimator": by["estimator"] if "gaze_deg" in measurements else None,
        "identity_model": by["identity_model"] if "identity_similarity" in measurements else None,
        "units": UNITS,
        "measurements": {name: estimate.to_dict() for name, estimate in measurements.items()},
        "subjects": subjects,
        "left_out": made.left_out or {},
        "failed": {name: reason(error) for name, error in sorted(failures.errors.items())},
    }  # fmt: skip
    with whole_file(options.out) as temporary:
        temporary.write_text(json.dumps(report, indent=2) + "\n")
    if not failures.errors:
        made.path.unlink()
    assert options.pairs is not None
    return PaperEvaluation(options.out, options.pairs, measurements, subjects, report["left_out"], report["failed"])


def chosen_pairs(options: EvaluateOptions, captures: CaptureSet) -> Pairs:
    """The pairs of the file that is named, or new ones, which are written to it.

    Raises:
        UserError: see `evaluate_redirection`.
    """
    if options.pairs is None:
        raise UserError("--protocol paper needs --pairs FILE; where it is not there, pairs are drawn and written to it")
    if options.seed < 0:
        raise UserError(f"--seed must be 0 or more, got {options.seed}")
    people = held_out_people(captures, options)
    if not people:
        raise UserError("--protocol paper measures people that training did not see; --held-out must be at least 1")
    check_radians(np.array([[c.gaze.pitch, c.gaze.yaw] for c in captures]), f"a gaze in {options.data}")
    if options.pairs.is_file():
        return load_pairs(options.pairs, captures, people)
    pairs = draw_pairs(captures, people, options.seed)
    save_pairs(pairs, options.pairs)
    return pairs


def _item(pair: Pair, captures: CaptureSet) -> Redirection:
    own = {capture.view: capture for capture in captures if capture.person == pair.person}
    return Redirection(pair.person, pair.name, own[pair.source], own[pair.target])
