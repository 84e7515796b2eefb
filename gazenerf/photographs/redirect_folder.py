"""A folder of photographs, each redirected; a run that was cut short goes on where it was."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from gazenerf.errors import UserError
from gazenerf.execution import Failures, Tell, Where, require_shared, results
from gazenerf.files import whole_file
from gazenerf.folders import Folder, folder_of, local_copy, names_in, reach
from gazenerf.head_model import load_head_model
from gazenerf.head_model.interface import HeadModel
from gazenerf.photographs.detector import photo_python
from gazenerf.photographs.folder_record import FolderRecord
from gazenerf.photographs.make_redirect import RedirectOptions, make_redirect
from gazenerf.photographs.marking import SUFFIXES
from gazenerf.photographs.picture import read_photograph
from gazenerf.workers import one_thread

RECORD = "redirect.json"
"""What was asked for and what became of each picture, beside the pictures."""

REDIRECTED, PASSED, UNREADABLE = "redirected", "passed on unchanged", "not readable"

Say = Callable[[str], None]
"""Is told one line about each picture."""


@dataclass(frozen=True)
class MadeFolder:
    """What became of the pictures of a folder.

    Attributes:
        folder: With the pictures and `redirect.json`.
        counts: How many were `REDIRECTED`, `PASSED` or `UNREADABLE`, of all runs.
        before: How many an earlier run had done.
    """

    folder: Folder
    counts: dict[str, int]
    before: int


def redirect_folder(
    folder: str | Folder,
    out: str | Folder,
    options: RedirectOptions,
    overwrite: bool = False,
    say: Say = lambda _: None,
    workers: int = 1,
    scheduler: str | None = None,
) -> MadeFolder:
    """Redirect every PNG, JPEG and WebP picture of a folder under the same names.

    A picture without a face, with several faces where no `--face` is given, in profile or with closed eyes is copied as
    it is. A file that is no picture is left out.

    Args:
        folder: Not searched below; a copy is made where it is a URL.
        out: Another folder, or its URL.
        options: Where the eyes shall look.
        overwrite: Begin anew.
        say: Is told about each picture, as it is done.
        workers: Processes; a script that asks for more than one keeps its own work under
            `if __name__ == "__main__":`, because each process imports it.
        scheduler: Address of a Dask scheduler whose workers do the work instead; they read and write the same folders.

    Raises:
        UserError: no pictures, a run with other options at `out`, options of a single photograph, processes died, a
            cluster is not there, or something unexpected went wrong with some pictures, which are named.
    """
    where, folder, out = Where(workers, scheduler), folder_of(folder), folder_of(out)
    reach(out)
    for name in ("subject", "landmarks", "masks", "labels"):
        if getattr(options, name):
            raise UserError(f"--{name} belongs to one photograph; redirect a folder without it")
    if out.resolve() == folder.resolve():
        raise UserError(f"--out {out} is the folder of the photographs; choose another one")
    files = sorted(file for file in local_copy(folder).iterdir() if file.suffix.lower() in SUFFIXES and file.is_file())
    if not files:
        raise UserError(f"{folder} holds no pictures; give a folder of {', '.join(SUFFIXES)} files")
    record = FolderRecord.of(
        out / RECORD, "redirected pictures", options, RedirectOptions, ("photo_python",), overwrite
    )
    photo_python(options.photo_python)
    there = names_in(out)
    before = [file.name for file in files if _is_done(record.files.get(file.name), file.name in there)]
    record.save()
    job = Redirecting(where.folder(folder), where.folder(out), where.placed(options))
    failures = Failures("picture", "pictures", "tries again")
    missing = [file.name for file in files if file.name not in before]
    record.note_all(results(job, missing, where), failures, say)
    return MadeFolder(out, {name: record.counts[name] for name in (REDIRECTED, PASSED, UNREADABLE)}, len(before))


@dataclass(frozen=True)
class Redirecting:
    """The job of redirecting pictures by their names; gives what is said of each.

    Attributes:
        folder: Of the photographs.
        out: With the record.
        options: Where the eyes shall look.
    """

    folder: Folder
    out: Folder
    options: RedirectOptions

    @contextmanager
    def opened(self) -> Iterator[Callable[[str, Tell], dict[str, Any]]]:
        """Load the head model."""
        require_shared(self.out / RECORD)
        folder = local_copy(self.folder)
        with one_thread():
            yield partial(self._redirect, folder, load_head_model(self.options.head_model))

    def _redirect(self, folder: Path, model: HeadModel, name: str, tell: Tell) -> dict[str, Any]:
        file = folder / name
        try:
            read_photograph(file)
        except UserError as error:
            return {"became": UNREADABLE, "why": str(error)}
        return _one(file, self.out / name, self.options, model)


def _is_done(said: dict[str, Any] | None, there: bool) -> bool:
    return said is not None and (there or said["became"] == UNREADABLE)


def _one(file: Path, target: Folder, options: RedirectOptions, model: HeadModel) -> dict[str, Any]:
    try:
        made = make_redirect(file, target, options, overwrite=True, model=model)
    except UserError as error:
        with whole_file(target) as temporary:
            shutil.copyfile(file, temporary)
        return {"became": PASSED, "why": str(error)}
    fitted = made.redirector.subject.gaze.degrees
    return {"became": REDIRECTED, "fitted_gaze_degrees": list(fitted), "warnings": made.warnings}
