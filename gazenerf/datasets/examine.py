"""What a data set's folder lacks, before anything is fitted."""

from __future__ import annotations

from dataclasses import dataclass, field

from gazenerf.data.rasterizer import Rasterizer
from gazenerf.datasets.choosing import chosen_pictures, chosen_subjects
from gazenerf.datasets.options import PrepareOptions
from gazenerf.datasets.published import PublishedSet
from gazenerf.datasets.registry import open_dataset
from gazenerf.errors import UserError
from gazenerf.folders import local_copy
from gazenerf.progress import Progress, silent

MOST_SAID = 4


@dataclass
class Examined:
    """What was found.

    Attributes:
        layout, split: Of the data set.
        subjects: How many of the chosen subjects are sound, and
        wanted: how many are chosen.
        pictures: Pictures that would be prepared.
        turned: Pictures that are left out because the head is turned too far.
        faulty: Pictures whose labels cannot be used.
        problems: One line each.
    """

    layout: str
    split: str
    subjects: int = 0
    wanted: int = 0
    pictures: int = 0
    turned: int = 0
    faulty: int = 0
    problems: list[str] = field(default_factory=list)

    def refuse(self) -> None:
        """Refuse to go on where something is wrong.

        Raises:
            UserError: the first problems, in one line.
        """
        if self.problems:
            more = f"; and {len(self.problems) - MOST_SAID} more" if len(self.problems) > MOST_SAID else ""
            raise UserError("; ".join(self.problems[:MOST_SAID]) + more)


def examine(options: PrepareOptions, progress: Progress = silent) -> tuple[PublishedSet, Examined]:
    """Open every chosen subject and look at its labels; no pixels are read.

    Args:
        options: What would be prepared.
        progress: Told about subjects.

    Raises:
        UserError: impossible settings, or a folder that is no such data set at all.
    """
    options.check()
    local_copy(options.root, progress)
    found = open_dataset(options.dataset, options.place)
    chosen = chosen_subjects(found, options.subjects, options.people)
    examined = Examined(found.layout, found.split, wanted=len(chosen))
    for check in (options.files.check, Rasterizer((options.size, options.size), 1).close):
        try:
            check()
        except UserError as error:
            examined.problems.append(str(error))
    for done, (number, subject) in enumerate(chosen, 1):
        try:
            with found.open(subject) as opened:
                kept, turned = chosen_pictures(opened.listed, options.pictures, number)
                if options.landmarks == "dataset" and not opened.has_landmarks:
                    raise UserError(
                        f"{subject} has no published landmarks; take --landmarks mediapipe or a folder of them"
                    )
        except UserError as error:
            examined.problems.append(str(error))
        else:
            faulty = sum(item.fault is not None for item in kept)
            examined.subjects += 1
            examined.pictures += len(kept) - faulty
            examined.turned += turned
            examined.faulty += faulty
        progress("checking", done, len(chosen))
    return found, examined
