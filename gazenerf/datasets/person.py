"""One person of a data set on the way to their captures."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from gazenerf.data.storage import SHARD_VIEWS
from gazenerf.datasets.person_record import CAPTURE, PersonRecord
from gazenerf.datasets.picture_jobs import Found, Group
from gazenerf.datasets.published import Listed

Say = Callable[[str], None]
"""Is told one line about each picture that fails."""


@dataclass(frozen=True)
class PersonPreparation:
    """What is left to do of a person.

    Attributes:
        number: Of the person.
        record: What was done, which is brought up to date.
        kept: Their chosen pictures, in published order.
        say: Told about pictures that fail.
    """

    number: int
    record: PersonRecord
    kept: Sequence[Listed]
    say: Say

    def note_faults(self) -> None:
        """Note pictures that cannot be used whatever is in them."""
        self._note_failed({item.name: item.fault for item in self.left if item.fault is not None})

    @property
    def left(self) -> list[Listed]:
        """Pictures of which nothing is known yet."""
        return [item for item in self.kept if item.name not in self.record.pictures]

    @property
    def whole(self) -> Group:
        """All that is left, to be fitted."""
        return Group(self.number, self.record.subject, self.left)

    @property
    def groups(self) -> list[Group]:
        """All that is left, a shard a group."""
        left = self.left
        return [
            Group(self.number, self.record.subject, left[first : first + SHARD_VIEWS], self.record.person)
            for first in range(0, len(left), SHARD_VIEWS)
        ]

    def note(self, found: Found) -> None:
        """Keep what a job found, on disk."""
        if found.person is not None:
            self.record.person, self.record.fitted_from = found.person, found.fitted_from
        self._note_failed(found.failed)
        view = {item.name: item.number for item in self.kept}
        for name, about in found.captures.items():
            self.record.pictures[name] = {"became": CAPTURE, "view": view[name], **about}
        self.record.save()

    def _note_failed(self, failed: dict[str, str]) -> None:
        for name, why in failed.items():
            if name not in self.record.pictures:
                self.say(f"{self.record.subject} {name}: {why}")
            self.record.failed(name, why)
