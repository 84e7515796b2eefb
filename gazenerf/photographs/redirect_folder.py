"""A folder of photographs redirected one after the other; a run that was cut short goes on where it was."""

from __future__ import annotations

import json
import shutil
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gazenerf.errors import UserError
from gazenerf.files import read_json, refuse_existing, whole_file
from gazenerf.head_model import load_head_model
from gazenerf.options import to_dict
from gazenerf.photographs.detector import photo_python
from gazenerf.photographs.make_redirect import RedirectOptions, make_redirect
from gazenerf.photographs.marking import SUFFIXES
from gazenerf.photographs.picture import read_photograph

RECORD = "redirect.json"
"""What was asked for and what became of each picture, beside the pictures."""

REDIRECTED, PASSED, UNREADABLE = "redirected", "passed on unchanged", "not readable"

MAX_RECORD_BYTES = 16 * 2**20

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

    folder: Path
    counts: dict[str, int]
    before: int


def redirect_folder(
    folder: Path, out: Path, options: RedirectOptions, overwrite: bool = False, say: Say = lambda _: None
) -> MadeFolder:
    """Redirect every PNG, JPEG and WebP picture of a folder under the same names.

    A picture without a face, with several faces where no `--face` is given, in profile or with closed eyes is copied as
    it is. A file that is no picture is left out.

    Args:
        folder: Not searched below.
        out: Another folder.
        options: Where the eyes shall look.
        overwrite: Begin anew.
        say: Is told about each picture.

    Raises:
        UserError: no pictures, a run with other options at `out`, or options of a single photograph.
    """
    for name in ("subject", "landmarks", "masks", "labels"):
        if getattr(options, name):
            raise UserError(f"--{name} belongs to one photograph; redirect a folder without it")
    if out.resolve() == folder.resolve():
        raise UserError(f"--out {out} is the folder of the photographs; choose another one")
    files = sorted(file for file in folder.iterdir() if file.suffix.lower() in SUFFIXES and file.is_file())
    if not files:
        raise UserError(f"{folder} holds no pictures; give a folder of {', '.join(SUFFIXES)} files")
    record = _record(out, options, overwrite)
    photo_python(options.photo_python)
    model, before = load_head_model(options.head_model), 0
    for file in files:
        target, done = out / file.name, record["files"].get(file.name)
        if done is not None and (target.exists() or done["became"] == UNREADABLE):
            before += 1
            continue
        try:
            read_photograph(file)
        except UserError as error:
            record["files"][file.name] = {"became": UNREADABLE, "why": str(error)}
        else:
            record["files"][file.name] = _one(file, target, options, model)
        with whole_file(out / RECORD) as temporary:
            temporary.write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")
        became = record["files"][file.name]
        say(f"{file.name}: {became['became']}{': ' + became['why'] if 'why' in became else ''}")
    counts = Counter(entry["became"] for entry in record["files"].values())
    return MadeFolder(out, {name: counts[name] for name in (REDIRECTED, PASSED, UNREADABLE)}, before)


def _one(file: Path, target: Path, options: RedirectOptions, model: Any) -> dict[str, Any]:
    try:
        made = make_redirect(file, target, options, overwrite=True, model=model)
    except UserError as error:
        with whole_file(target) as temporary:
            shutil.copyfile(file, temporary)
        return {"became": PASSED, "why": str(error)}
    fitted = made.redirector.subject.gaze.degrees
    return {"became": REDIRECTED, "fitted_gaze_degrees": list(fitted), "warnings": made.warnings}


def _record(out: Path, options: RedirectOptions, overwrite: bool) -> dict[str, Any]:
    """The record of an earlier run with the same options, or a new one."""
    asked = {name: value for name, value in to_dict(options, RedirectOptions).items() if name != "photo_python"}
    fresh = {"asked": asked, "files": {}}
    if overwrite or not (out / RECORD).exists():
        refuse_existing([out], overwrite)
        return fresh
    found = read_json(out / RECORD, MAX_RECORD_BYTES, absent="", large="this is no record of redirected pictures")
    if not isinstance(found, dict) or found.get("asked") != json.loads(json.dumps(asked)):
        raise UserError(
            f"{out} has pictures that were made with other options; add --overwrite or choose another --out"
        )
    if not all(isinstance(entry, dict) and "became" in entry for entry in found.get("files", {"": 0}).values()):
        raise UserError(f"{out / RECORD} is no record of redirected pictures; add --overwrite")
    return found
