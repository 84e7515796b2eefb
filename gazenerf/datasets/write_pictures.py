"""The pictures of a data set as files, for other programs that find landmarks, masks or face parts in them."""

from __future__ import annotations

from pathlib import Path

from PIL import Image

from gazenerf.datasets.choosing import chosen_pictures, chosen_subjects
from gazenerf.datasets.options import PrepareOptions
from gazenerf.datasets.published import PublishedSet
from gazenerf.errors import UserError
from gazenerf.files import whole_file
from gazenerf.progress import Progress, silent


def write_pictures(found: PublishedSet, options: PrepareOptions, folder: Path, progress: Progress = silent) -> int:
    """Write the chosen pictures as `SUBJECT/PICTURE.png`, in the pixels that landmarks, masks and labels speak of.

    Returns:
        How many were written now; those that are there stay.

    Raises:
        UserError: a picture is damaged, or the folder cannot be written.
    """
    written = 0
    for number, subject in chosen_subjects(found, options.subjects, options.people):
        with found.open(subject) as opened:
            kept, _ = chosen_pictures(opened.listed, options.pictures, number)
            for done, item in enumerate(kept, 1):
                path = folder / subject / f"{item.name}.png"
                if item.fault is None and not path.exists():
                    try:
                        pixels = opened.read(item.number).pixels
                    except UserError:
                        continue  # the run itself tells of it
                    with whole_file(path) as temporary:
                        Image.fromarray(pixels).save(temporary)
                    written += 1
                progress(f"writing {subject}", done, len(kept))
    return written
