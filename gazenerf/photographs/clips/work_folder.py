"""What is done of a video lies beside its output until all is done, so that a run that was cut short goes on."""

from __future__ import annotations

import json
import shutil
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from gazenerf.errors import UserError
from gazenerf.files import read_json, reading_numpy, whole_file

ASKED = "asked.json"
MAX_ASKED_BYTES = 2**20
DAMAGED = (OSError, ValueError, KeyError, EOFError, NotImplementedError, zipfile.BadZipFile, zlib.error)


class WorkFolder:
    """Arrays by name in a folder, for one input and one set of options.

    Args:
        out: The output; the folder lies beside it and is named after it.
        asked: What the results depend on, JSON-able.
        overwrite: Begin anew.

    Raises:
        UserError: the folder holds results of another input or of other options.
    """

    def __init__(self, out: Path, asked: Mapping[str, Any], overwrite: bool) -> None:
        self.path = out.with_name(f"{out.name}.work")
        asked = json.loads(json.dumps(asked))
        if overwrite:
            self.delete()
        self.resumed = (self.path / ASKED).exists()
        if self.resumed:
            absent = large = "add --overwrite to begin anew"
            if read_json(self.path / ASKED, MAX_ASKED_BYTES, absent=absent, large=large) != asked:
                raise UserError(
                    f"{self.path} has what was done with another video or other options; add --overwrite to begin "
                    "anew, or choose another --out"
                )
            return
        with whole_file(self.path / ASKED) as temporary:
            temporary.write_text(json.dumps(asked, indent=2) + "\n", encoding="utf-8")

    def has(self, name: str) -> bool:
        """Whether arrays of that name were kept."""
        return (self.path / f"{name}.npz").exists()

    def keep(self, name: str, arrays: Mapping[str, np.ndarray]) -> None:
        """Keep arrays, whole or not at all."""
        with whole_file(self.path / f"{name}.npz") as temporary, temporary.open("wb") as file:
            np.savez_compressed(file, **arrays)  # type: ignore[arg-type]

    def kept(self, name: str) -> dict[str, np.ndarray]:
        """Arrays that were kept.

        Raises:
            UserError: damaged.
        """
        path = self.path / f"{name}.npz"
        try:
            with reading_numpy(), np.load(path, allow_pickle=False) as arrays:
                return {key: arrays[key] for key in arrays.files}
        except DAMAGED as error:
            raise UserError(f"{path} is damaged; add --overwrite to begin anew") from error

    def delete(self) -> None:
        """Remove all of it."""
        shutil.rmtree(self.path, ignore_errors=True)
