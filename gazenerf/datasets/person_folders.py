"""Data sets that are a folder with one folder for each person, and have no split."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import ClassVar

from gazenerf.datasets.published import Place, SubjectPictures
from gazenerf.errors import UserError

ALL = "all"


class PersonFolders(ABC):
    """Such a data set; a kind of it says which.

    Args:
        place: Folder with the people's.

    Attributes:
        title: Of the data set, for messages.
        names: Of the people's folders, in published order.
        version: Ends messages about another version.

    Raises:
        UserError: it has no such folders, or a split is asked for.
    """

    layout: ClassVar[str]
    title: ClassVar[str]
    names: ClassVar[tuple[str, ...]]
    version: ClassVar[str]

    def __init__(self, place: Place) -> None:
        self._root, self.split = place.root, place.split or ALL
        if self.split != ALL:
            raise UserError(f"{self.title} has no split {self.split!r}; leave --split out")
        self.subjects = {name: number for number, name in enumerate(self.names)}
        if not any((place.root / name).is_dir() for name in self.names):
            raise UserError(f"{place.root} has no folder {self.names[0]} to {self.names[-1]}; {self.version}")

    @contextmanager
    def open(self, subject: str) -> Iterator[SubjectPictures]:
        """See `PublishedSet`."""
        folder = self._root / subject
        if not folder.is_dir():
            raise UserError(f"{folder} does not exist; download it, or leave the subject out with --subjects")
        yield self.pictures(folder)

    @abstractmethod
    def pictures(self, folder: Path) -> SubjectPictures:
        """The pictures of a person's folder."""
