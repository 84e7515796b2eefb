"""What an experiment found, as one JSON object."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from gazenerf import __version__
from gazenerf.evaluation.intervals import over_subjects
from gazenerf.evaluation.redirectors import load_model
from gazenerf.experiments.checked import Data
from gazenerf.experiments.curves import REAL, Curves
from gazenerf.experiments.options import ExperimentOptions
from gazenerf.experiments.planned import Source
from gazenerf.experiments.published import FILE, published
from gazenerf.experiments.rows import title_of
from gazenerf.experiments.tasks import Task, read_record

COMPARED = ("gaze_deg", "head_deg", "ssim", "psnr", "lpips", "identity_similarity", "gaze_label_deg")
"""What rows are compared in, person by person; a Frechet distance is of all people together."""

OWN_ERRORS = ("gaze_estimator_deg", "head_estimator_deg")
"""What the estimator errs by on the targets' own pictures; the same in every row."""


def table_result(
    options: ExperimentOptions,
    data: Data,
    judge: Source,
    rows: Mapping[str, Task],
    measured: Mapping[tuple[str, str], Task],
    failed: Mapping[str, str],
) -> dict[str, Any]:
    """The result of every experiment but the calibration.

    Args:
        options, data, judge: Of the experiment.
        rows: Row to its training.
        measured: Row and name of the captures to its measurement.
        failed: `ROW on NAME` to why it is missing.
    """
    sets: dict[str, Any] = {}
    for test in data.tests:
        found: dict[str, Any] = {}
        reports = {}
        for row, training in rows.items():
            about: dict[str, Any] = {"title": title_of(options.experiment, row), "training": training.name}
            if why := failed.get(f"{row} on {test.name}"):
                found[row] = about | {"failed": why}
                continue
            report = json.loads(measured[row, test.name].made.read_text(encoding="utf-8"))
            reports[row] = report
            found[row] = about | {"measurements": report["measurements"], "left_out": report["left_out"],
                                  "failed_pairs": report["failed"]}  # fmt: skip
        own = next((report["measurements"] for report in reports.values()), {})
        sets[test.name] = {
            "data": str(test.data),
            "people": test.people,
            "pairs": next((report["pairs"] for report in reports.values()), None),
            "estimator_error": {name: own[name] for name in OWN_ERRORS if name in own},
            "rows": found,
            "differences": differences({row: report["subjects"] for row, report in reports.items()}),
        }
    return _about(options, data, judge, rows) | {"sets": sets, "failed": dict(failed)}


def differences(subjects: Mapping[str, Mapping[str, Mapping[str, float]]]) -> dict[str, Any]:
    """How much each row differs from the last one, person by person, which says more than two intervals do.

    Args:
        subjects: Row to person to measurement to mean, as in reports of `gazenerf evaluate`.

    Returns:
        `from`, the last row, and `rows`: row to measurement to the mean difference with its interval.
    """
    if len(subjects) < 2:
        return {}
    *others, last = subjects
    found: dict[str, Any] = {}
    for row in others:
        people = [person for person in subjects[row] if person in subjects[last]]
        pairs = [(subjects[row][person], subjects[last][person]) for person in people]
        found[row] = {
            name: over_subjects([own[name] - theirs[name] for own, theirs in pairs]).to_dict()
            for name in COMPARED
            if pairs and all(name in own and name in theirs for own, theirs in pairs)
        }
    return {"from": last, "rows": found}


def calibration_result(
    options: ExperimentOptions,
    data: Data,
    judge: Source,
    rows: Mapping[str, Task],
    curves: Curves,
    failed: Mapping[str, str],
) -> dict[str, Any]:
    """The result of the calibration."""
    methods = {REAL: {"title": "real samples alone", **curves.of(REAL)}}
    methods |= {
        row: {"title": f"real and {title_of(options.experiment, row)}", **curves.of(row)}
        for row in rows
        if row not in failed
    }
    return _about(options, data, judge, rows) | {
        "set": {"data": str(options.data), "people": curves.people, "test_pictures": curves.test_pictures},
        "real": list(options.real),
        "samples": options.samples,
        "steps": options.calibration_steps,
        "before": curves.before.to_dict(),
        "methods": methods,
        "failed": dict(failed),
    }


def _about(options: ExperimentOptions, data: Data, judge: Source, rows: Mapping[str, Task]) -> dict[str, Any]:
    paper = published()[options.experiment]
    return {
        "experiment": options.experiment,
        "gazenerf": __version__,
        "data": {
            "folder": str(options.data), "hash": data.hash, "pixels": int(data.first.image.shape[0]),
            "people": data.people, "held_out": options.held_out,
        },
        "preset": options.preset,
        "settings": list(options.settings),
        "sted_settings": list(options.sted_settings),
        "minutes": options.minutes,
        "estimator": {"name": judge.identity, **({} if judge.task is None else _cost(judge.task))},
        "trainings": {task.name: _trained(task) for task in rows.values()},
        "paper": {
            "source": json.loads(FILE.read_text(encoding="utf-8"))["source"], "table": paper.table,
            "label": paper.label, "sets": paper.sets, "said": paper.said,
            "comparable": "no: other people, photographs, an estimator and networks of their own",
        },
    }  # fmt: skip


def _trained(task: Task) -> dict[str, Any]:
    """What is known of a training."""
    if not task.made.is_file():
        return _cost(task)
    about = load_model(task.made).about
    return {name: about[name] for name in ("steps", "minutes", "pictures") if name in about} | _cost(task)


def _cost(task: Task) -> dict[str, Any]:
    record = read_record(task)
    return {
        "command": record.get("command"),
        "process_minutes": round(float(record.get("seconds", 0.0)) / 60.0, 1),
        "machines": record.get("machines", []),
        "finished": bool(record.get("finished")),
    }
