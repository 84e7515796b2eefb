"""What was asked of a folder of photographs and what became of each: a JSON file beside the results."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Collection, Generator
from contextlib import closing
from dataclasses import dataclass, field
from typing import Any

from gazenerf.errors import UserError
from gazenerf.execution import Done, Failures
from gazenerf.files import read_json, refuse_existing, whole_file
from gazenerf.folders import Folder
from gazenerf.options import to_dict

MAX_BYTES = 16 * 2**20


@dataclass
class FolderRecord:
    """A folder so far.

    Attributes:
        path: The file.
        asked: Options, as JSON holds them.
        files: Name of a photograph to what is said of it; `became` says what it became.
    """

    path: Folder
    asked: dict[str, Any]
    files: dict[str, dict[str, Any]] = field(default_factory=dict)

    @classmethod
    def of(
        cls, path: Folder, what: str, options: object, kind: type, but: Collection[str], overwrite: bool
    ) -> FolderRecord:
        """The record of an earlier run with the same options, or a new one, which is not yet written.

        Args:
            path: The file.
            what: What it is a record of.
            options: They are asked.
            kind: A class that they inherit from; its fields count,
            but: without these.
            overwrite: Begin anew.

        Raises:
            UserError: the folder holds something else, or what was made with other options.
        """
        asked = {name: value for name, value in to_dict(options, kind).items() if name not in but}
        if overwrite or not path.exists():
            refuse_existing([path.parent], overwrite)
            return cls(path, asked)
        found = read_json(path, MAX_BYTES, absent="", large=f"this is no record of {what}")
        if not isinstance(found, dict) or found.get("asked") != json.loads(json.dumps(asked)):
            raise UserError(
                f"{path.parent} has {what} that were made with other options; add --overwrite or choose another --out"
            )
        files = found.get("files")
        if not isinstance(files, dict) or not all(isinstance(e, dict) and "became" in e for e in files.values()):
            raise UserError(f"{path} is no record of {what}; add --overwrite")
        return cls(path, asked, files)

    def note(self, name: str, said: dict[str, Any]) -> None:
        """Say what became of a photograph, and write the record."""
        self.files[name] = said
        self.save()

    def note_all(self, every: Generator[Done, None, None], failures: Failures, say: Callable[[str], None]) -> None:
        """Note what became of photographs as they are done, and tell of each.

        Args:
            every: Results, by the photographs' names; closed at the end.
            failures: Takes what went wrong.
            say: Is told one line about each photograph.

        Raises:
            UserError: something went wrong with some photographs, which are named.
        """
        with closing(every):
            for done in every:
                if done.error is not None:
                    if failures.add(done.item, done.error):
                        break
                    continue
                became = done.result
                self.note(done.item, became)
                say(f"{done.item}: {became['became']}{': ' + became['why'] if 'why' in became else ''}")
        failures.refuse()

    def save(self) -> None:
        """Write it whole, photographs by name."""
        self.files = dict(sorted(self.files.items()))
        with whole_file(self.path) as temporary:
            text = json.dumps({"asked": self.asked, "files": self.files}, indent=2)
            temporary.write_text(text + "\n", encoding="utf-8")

    @property
    def counts(self) -> Counter[str]:
        """How many photographs became what."""
        return Counter(said["became"] for said in self.files.values())
