"""What became of each picture of a person, and who the person is: a JSON file beside the person's shards."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from gazenerf.errors import UserError
from gazenerf.files import read_json, whole_file
from gazenerf.folders import Folder
from gazenerf.photographs.fit import KnownPerson

MAX_RECORD_BYTES = 256 * 2**20

CAPTURE, FAILED = "capture", "failed"


@dataclass
class PersonRecord:
    """A person so far.

    Attributes:
        path: The file.
        subject: As the data set calls them.
        person: Identity and texture; None before they are fitted.
        fitted_from: From how many pictures.
        pictures: Name to what became of it: `became` is `CAPTURE` with `view` and measures, or `FAILED` with `why`.
    """

    path: Folder
    subject: str
    person: KnownPerson | None = None
    fitted_from: int = 0
    pictures: dict[str, dict[str, Any]] = field(default_factory=dict)

    @classmethod
    def load(cls, folder: Folder, number: int, subject: str) -> PersonRecord:
        """The record of an earlier run, or a new one.

        Raises:
            UserError: it is damaged, or of another subject.
        """
        path = folder / f"person-{number:04d}.json"
        if not path.exists():
            return cls(path, subject)
        found = read_json(path, MAX_RECORD_BYTES, absent="", large="records are smaller")
        try:
            if found["subject"] != subject:
                raise UserError(f"{path} is of {found['subject']}, not of {subject}; choose another --out")
            person = None
            if found["identity"] is not None:
                person = KnownPerson(*(np.array(found[key], dtype=np.float64) for key in ("identity", "texture")))
            pictures = {str(name): dict(said) for name, said in found["pictures"].items()}
            if any(said["became"] not in (CAPTURE, FAILED) for said in pictures.values()):
                raise ValueError("an unknown outcome")
            return cls(path, subject, person, int(found["fitted_from"]), pictures)
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise UserError(f"{path} is no record of a person; delete it to prepare {subject} again") from error

    def save(self) -> None:
        """Write it whole."""
        person = self.person
        said = {
            "subject": self.subject,
            "fitted_from": self.fitted_from,
            "identity": None if person is None else person.identity.tolist(),
            "texture": None if person is None else person.texture.tolist(),
            "pictures": dict(sorted(self.pictures.items())),
        }
        with whole_file(self.path) as temporary:
            temporary.write_text(json.dumps(said, indent=1) + "\n", encoding="utf-8")

    def failed(self, name: str, why: str) -> None:
        """Note a picture that became nothing."""
        self.pictures[name] = {"became": FAILED, "why": why}

    @property
    def counts(self) -> Counter[str]:
        """How many pictures became what."""
        return Counter(said["became"] for said in self.pictures.values())

    def measures(self, name: str) -> list[float]:
        """A measure of all captures that have it."""
        return [said[name] for said in self.pictures.values() if said.get(name) is not None]
