"""A folder of photographs of different people, each fitted by itself; a run that was cut short goes on where it was."""

from __future__ import annotations

import shutil
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from gazenerf.errors import UserError
from gazenerf.execution import Failures, Tell, Where, require_shared, results
from gazenerf.files import whole_file
from gazenerf.folders import Folder, folder_of, local_copy, names_in, reach
from gazenerf.head_model import load_head_model
from gazenerf.photographs.detector import photo_python
from gazenerf.photographs.fit_options import FieldFitOptions
from gazenerf.photographs.folder_record import FolderRecord
from gazenerf.photographs.make_fit import field_to_tune, make_fit
from gazenerf.photographs.marking import SUFFIXES
from gazenerf.progress import Progress, advancing, silent
from gazenerf.workers import one_thread

RECORD = "fit-each.json"
"""What was asked for and what became of each photograph, beside the subjects."""

FITTED, FAILED = "fitted", "failed"

BESIDE = {"landmarks": (".npy", ".npz", ".json", ".csv"), "masks": (".png",), "labels": (".png",)}
"""Option that takes a folder here to the suffixes of its files."""

NOT_ASKED = ("photo_python", "preview", "preview_every")


@dataclass(frozen=True)
class FittedFolder:
    """What became of the photographs of a folder.

    Attributes:
        folder: With the subjects and `fit-each.json`.
        counts: How many were `FITTED` or `FAILED`, of all runs.
        before: How many an earlier run had fitted.
    """

    folder: Folder
    counts: Counter[str]
    before: int


def fit_folder(
    folder: str | Folder,
    out: str | Folder,
    options: FieldFitOptions | None = None,
    overwrite: bool = False,
    progress: Progress = silent,
    say: Callable[[str], None] = lambda _: None,
    workers: int = 1,
    scheduler: str | None = None,
) -> FittedFolder:
    """Fit every PNG, JPEG and WebP picture of a folder as `make_fit` fits one, in one thread; one subject for each.

    A photograph that cannot be fitted is noted and told of, and the others go on; the same call tries it again.

    Args:
        folder: Not searched below; a copy is made where it is a URL.
        out: Another folder, or its URL; a photograph `NAME.jpg` becomes `NAME.safetensors` with files beside it.
        options: How they are fitted; `landmarks`, `masks` and `labels` name one folder each, with files of the
            photographs' names.
        overwrite: Begin anew.
        progress: Told about photographs.
        say: Is told about each photograph, as it is done.
        workers: Processes; a script that asks for more than one keeps its own work under
            `if __name__ == "__main__":`, because each process imports it.
        scheduler: Address of a Dask scheduler whose workers do the work instead; they read and write the same folders.

    Raises:
        UserError: no pictures, two of one name, a run with other options at `out`, options of a single photograph, a
            field that cannot be fine-tuned, processes died, a cluster is not there, or something unexpected went wrong
            with some photographs, which are named.
    """
    options = options or FieldFitOptions()
    where, folder, out = Where(workers, scheduler), folder_of(folder), folder_of(out)
    _check(options)
    reach(out)
    names = _photographs(local_copy(folder), folder, out)
    record = FolderRecord.of(out / RECORD, "subjects", options, FieldFitOptions, NOT_ASKED, overwrite)
    there = names_in(out)
    before = [
        name
        for name in names
        if record.files.get(name, {}).get("became") == FITTED and f"{Path(name).stem}.safetensors" in there
    ]
    record.save()
    job = Fitting(where.folder(folder), where.folder(out), _placed(options, where), overwrite)
    failures = Failures("photograph", "photographs", "tries again")
    advance = advancing(progress, "fitting people", len(before), len(names))
    missing = [name for name in names if name not in before]
    record.note_all(results(job, missing, where, advance=advance), failures, say)
    return FittedFolder(out, Counter(record.files[name]["became"] for name in names), len(before))


@dataclass(frozen=True)
class Fitting:
    """The job of fitting photographs by their names; gives what is said of each.

    Attributes:
        folder: Of the photographs.
        out: With the record.
        options: See `fit_folder`.
        anew: What an earlier run had begun is not gone on with.
    """

    folder: Folder
    out: Folder
    options: FieldFitOptions
    anew: bool = False

    @contextmanager
    def opened(self) -> Iterator[Callable[[str, Tell], dict[str, Any]]]:
        """See that the folders are there."""
        require_shared(self.out / RECORD)
        folder = local_copy(self.folder)
        with one_thread():
            yield partial(self._fit, folder)

    def _fit(self, folder: Path, name: str, tell: Tell) -> dict[str, Any]:
        stem = Path(name).stem
        with tempfile.TemporaryDirectory(prefix="gazenerf-") as here:
            place = self.out if isinstance(self.out, Path) else Path(here)
            anew = self.anew or not (place / f"{stem}.state.pt").exists()
            target = place / f"{stem}.safetensors"
            try:
                (made,) = make_fit([folder / name], target, _of_one(self.options, stem), overwrite=anew)
            except UserError as error:
                return {"became": FAILED, "why": str(error)}
            for file in sorted(Path(here).iterdir(), key=lambda file: file == target):
                with whole_file(self.out / file.name) as temporary:
                    shutil.copyfile(file, temporary)
        gaze = list(made.fitted.subject.gaze.degrees)
        return {"became": FITTED, "gaze_degrees": gaze, "warnings": made.fitted.warnings}


def _check(options: FieldFitOptions) -> None:
    """Refuse, before anything starts, what no photograph could be fitted with.

    Raises:
        UserError: it could not.
    """
    if options.preview is not None:
        raise UserError("--preview shows one person; leave it out with --each")
    for name in BESIDE:
        given = getattr(options, name)
        if given and not (len(given) == 1 and given[0].is_dir()):
            raise UserError(f"--{name} takes one folder with --each, with a file for each photograph, of the same name")
    if not options.landmarks:
        photo_python(options.photo_python)
    model = load_head_model(options.head_model)
    if options.field:
        field_to_tune(options, model.code_sizes)


def _photographs(files: Path, folder: Folder, out: Folder) -> list[str]:
    """Names of the photographs.

    Raises:
        UserError: there are none, or their results would have one name.
    """
    if not files.is_dir():
        raise UserError(f"there is no folder {folder}; --each takes a folder of photographs, one of each person")
    if out == folder or (isinstance(out, Path) and out.resolve() == files.resolve()):
        raise UserError(f"--out {out} is the folder of the photographs; choose another one")
    names = sorted(file.name for file in files.iterdir() if file.suffix.lower() in SUFFIXES and file.is_file())
    if not names:
        raise UserError(f"{folder} holds no pictures; give a folder of {', '.join(SUFFIXES)} files")
    stems = Counter(Path(name).stem for name in [*names, RECORD])
    if twice := next((name for name in names if stems[Path(name).stem] > 1), None):
        raise UserError(f"{folder / twice} shares its name but the suffix with another file of --out; rename it")
    return names


def _placed(options: FieldFitOptions, where: Where) -> FieldFitOptions:
    """Options whose paths mean the same to every worker."""
    beside: dict[str, Sequence[Path]] = {
        name: tuple(where.folder(path) for path in getattr(options, name)) for name in BESIDE
    }
    return replace(where.placed(options), **beside)  # pyright: ignore[reportArgumentType]


def _of_one(options: FieldFitOptions, stem: str) -> FieldFitOptions:
    """Options with the files of one photograph.

    Raises:
        UserError: one is missing.
    """
    found: dict[str, tuple[Path, ...]] = {}
    for name, suffixes in BESIDE.items():
        for folder in getattr(options, name):
            files = [folder / f"{stem}{suffix}" for suffix in suffixes]
            file = next((file for file in files if file.is_file()), None)
            if file is None:
                raise UserError(f"--{name} {folder} has no file {' or '.join(file.name for file in files)}")
            found[name] = (file,)
    return replace(options, **found)  # pyright: ignore[reportArgumentType]
