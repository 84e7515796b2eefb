"""Captures of a published data set: each person fitted, each picture normalised, cut out and stored; resumable."""

from __future__ import annotations

from collections import Counter
from collections.abc import Generator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from gazenerf.data.storage import write_manifest
from gazenerf.datasets.choosing import chosen_pictures, chosen_subjects
from gazenerf.datasets.examine import Examined, examine
from gazenerf.datasets.options import PrepareOptions
from gazenerf.datasets.person import PersonPreparation, Say
from gazenerf.datasets.person_record import CAPTURE, FAILED, PersonRecord
from gazenerf.datasets.picture_jobs import CaptureMaking, Found, Group, PersonFitting
from gazenerf.datasets.published import PublishedSet
from gazenerf.errors import UserError
from gazenerf.execution import Done, Failures, Where, results
from gazenerf.folders import Folder, folder_of, reach
from gazenerf.head_model import load_head_model
from gazenerf.head_model.interface import HeadModel
from gazenerf.head_model.model import METRES_PER_UNIT
from gazenerf.progress import Progress, advancing, silent


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


def prepare(
    options: PrepareOptions,
    out: str | Folder,
    progress: Progress = silent,
    say: Say = lambda _: None,
    workers: int = 1,
    scheduler: str | None = None,
) -> Prepared:
    """Write captures of a published data set to a folder; what is there already is kept.

    A picture that cannot be used is noted in its person's JSON file and told of, and the others go on.

    Args:
        options: What is prepared.
        out: The folder or its URL, also of an earlier run with the same settings; other `subjects` and `people` may be
            added.
        progress: Told about people, then about pictures.
        say: Told about each picture that fails.
        workers: Processes; a script that asks for more than one keeps its own work under
            `if __name__ == "__main__":`, because each process imports it.
        scheduler: Address of a Dask scheduler whose workers do the work instead; they read and write the same folders.

    Raises:
        UserError: `examine` finds something wrong, the folder holds another set, nothing became a capture, processes
            died, a cluster is not there, or something unexpected kept some pictures from being looked at.
    """
    where, out = Where(workers, scheduler), folder_of(out)
    reach(out)
    found, examined = examine(options, progress)
    examined.refuse()
    model = load_head_model()
    write_manifest(out, _manifest(options, found, model))
    people, before = [], 0
    for number, subject in chosen_subjects(found, options.subjects, options.people):
        record = PersonRecord.load(out, number, subject)
        before += len(record.pictures)
        with found.open(subject) as opened:
            kept, _ = chosen_pictures(opened.listed, options.pictures, number)
        people.append(PersonPreparation(number, record, kept, say))
    placed = where.placed(options)
    if options.landmark_source == "files":
        placed = replace(placed, landmarks=str(where.folder(Path(options.landmarks))))
    _prepare(people, placed, where.folder(out), where, progress)
    records = [person.record for person in people]
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


def _prepare(
    people: Sequence[PersonPreparation], options: PrepareOptions, out: Folder, where: Where, progress: Progress
) -> None:
    """Fit those who are not fitted, then make captures of everybody's pictures.

    Raises:
        UserError: a job failed as a whole for some pictures, which are named; the others are done, unless many failed.
    """
    of = {person.number: person for person in people}
    for person in people:
        person.note_faults()
    unknown = [person.whole for person in people if person.left and person.record.person is None]
    failures = Failures("group of pictures", "groups of pictures", "tries again")

    def note(every: Generator[Done[Group, Found], None, None]) -> None:
        with closing(every):
            for done in every:
                group = done.item
                if done.error is None:
                    of[group.number].note(done.result)
                elif failures.add(f"{group.subject} from {group.items[0].name} on", done.error):
                    failures.refuse()

    advance = advancing(progress, "fitting people", len(people) - len(unknown), len(people))
    note(results(PersonFitting(options), unknown, where, advance=advance))
    groups = [group for person in people if person.record.person is not None for group in person.groups]
    total = sum(len(person.kept) for person in people)
    advance = advancing(progress, "preparing", total - sum(len(group.items) for group in groups), total)
    note(results(CaptureMaking(options, out), groups, where, size=lambda group: len(group.items), advance=advance))
    for person in people:
        person.record.save()
    failures.refuse()


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
