"""Captures of a published data set: each person fitted, each picture normalised, cut out and stored; resumable."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gazenerf.data.storage import write_manifest
from gazenerf.datasets.choosing import chosen_pictures, chosen_subjects
from gazenerf.datasets.examine import Examined, examine
from gazenerf.datasets.options import PrepareOptions
from gazenerf.datasets.person import PersonPreparation, Say
from gazenerf.datasets.person_record import CAPTURE, FAILED, PersonRecord
from gazenerf.datasets.published import PublishedSet
from gazenerf.errors import UserError
from gazenerf.head_model import load_head_model
from gazenerf.head_model.interface import HeadModel
from gazenerf.head_model.model import METRES_PER_UNIT
from gazenerf.progress import Progress, silent


@dataclass(frozen=True)
class Prepared:
    """What became of a data set.

    Attributes:
        examined: What was there.
        counts: How many pictures became `CAPTURE` or `FAILED`, of all runs.
        before: How many an earlier run had done.
        from_irises, from_published_pose: Median degrees between the labels and the gaze that fitted irises tell, and
            the labels by the published head pose; None where nothing tells.
    """

    examined: Examined
    counts: Counter[str]
    before: int
    from_irises: float | None
    from_published_pose: float | None


def prepare(options: PrepareOptions, out: Path, progress: Progress = silent, say: Say = lambda _: None) -> Prepared:
    """Write captures of a published data set to a folder; what is there already is kept.

    A picture that cannot be used is noted in its person's JSON file and told of, and the others go on.

    Args:
        options: What is prepared.
        out: The folder, also of an earlier run with the same settings; other `subjects` and `people` may be added.
        progress: Told about pictures.
        say: Told about each picture that fails.

    Raises:
        UserError: `examine` finds something wrong, the folder holds another set, or nothing became a capture.
    """
    found, examined = examine(options, progress)
    examined.refuse()
    model = load_head_model()
    write_manifest(out, _manifest(options, found, model))
    records, before, done = [], 0, 0
    for number, subject in chosen_subjects(found, options.subjects, options.people):
        record = PersonRecord.load(out, number, subject)
        before += len(record.pictures)
        with found.open(subject) as opened:
            kept, _ = chosen_pictures(opened.listed, options.pictures, number)
            for count in PersonPreparation(options, out, model, number, opened, record, say).prepare(kept):
                done += count
                progress("preparing", done, examined.pictures + examined.faulty)
        records.append(record)
    counts: Counter[str] = sum((record.counts for record in records), Counter())
    if not counts[CAPTURE]:
        why = next((said["why"] for record in records for said in record.pictures.values()), "there are no pictures")
        raise UserError(f"none of {counts[FAILED]} pictures became a capture ({why})")
    return Prepared(
        examined,
        counts,
        before,
        *(_median(records, f"label_from_{key}_degrees") for key in ("irises", "published_pose")),
    )


def _median(records: Sequence[PersonRecord], name: str) -> float | None:
    values = [value for record in records for value in record.measures(name)]
    return float(np.median(values)) if values else None


def _manifest(options: PrepareOptions, found: PublishedSet, model: HeadModel) -> dict[str, Any]:
    """What must be the same for a run to go on; which subjects are prepared may grow."""
    return {
        "dataset": options.dataset,
        "layout": found.layout,
        "split": found.split,
        "pictures": options.pictures,
        "size": options.size,
        "landmarks": options.landmark_source,
        "masks": "labels" if options.labels else "files" if options.masks else options.landmark_source,
        "expressions": "photographed",
        "head_model": model.name,
        "code_sizes": list(model.code_sizes),
        "metres_per_unit": METRES_PER_UNIT,
    }
