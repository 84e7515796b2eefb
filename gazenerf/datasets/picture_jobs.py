"""What is done to the pictures of a person: the person is fitted to some, then all become captures, group by group."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from gazenerf.data.captures import Capture
from gazenerf.data.storage import MANIFEST, SHARD_VIEWS, write_shard
from gazenerf.datasets.faces import Face, find_faces
from gazenerf.datasets.make_capture import make_capture
from gazenerf.datasets.options import PrepareOptions
from gazenerf.datasets.person_fit import fit_person, telling
from gazenerf.datasets.published import Listed, PublishedSet, Sample, SubjectPictures
from gazenerf.datasets.registry import open_dataset
from gazenerf.errors import UserError
from gazenerf.execution import Tell, require_shared
from gazenerf.folders import Folder
from gazenerf.head_model import load_head_model
from gazenerf.head_model.interface import HeadModel
from gazenerf.photographs.fit import KnownPerson, Photograph, fit_photographs
from gazenerf.photographs.normalisation import FOCAL_LENGTHS
from gazenerf.workers import one_thread


@dataclass(frozen=True, eq=False)
class Group:
    """Pictures of one person.

    Attributes:
        number: Of the person.
        subject: As the data set calls them.
        items: The pictures.
        person: Identity and texture; None where they are to be fitted.
    """

    number: int
    subject: str
    items: Sequence[Listed]
    person: KnownPerson | None = None


@dataclass
class Found:
    """What became of a group.

    Attributes:
        person: Identity and texture, where they were fitted.
        fitted_from: From how many pictures.
        captures: Picture to what is said of its capture, which was written.
        failed: Picture to why it became nothing.
    """

    person: KnownPerson | None = None
    fitted_from: int = 0
    captures: dict[str, dict[str, Any]] = field(default_factory=dict)
    failed: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class PersonFitting:
    """The job of fitting identity and texture to telling pictures of a person.

    Attributes:
        options: How.
    """

    options: PrepareOptions

    @contextmanager
    def opened(self) -> Iterator[Callable[[Group, Tell], Found]]:
        """Open the data set and the head model."""
        with one_thread():
            yield partial(self._fit, open_dataset(self.options.dataset, self.options.place), load_head_model())

    def _fit(self, dataset: PublishedSet, model: HeadModel, group: Group, tell: Tell) -> Found:
        """Fit to telling pictures, or to the first ones where no face is found in those; where that fails too, no
        picture of the person can be used."""
        found, items, why = Found(), group.items, "no picture can be read"
        with dataset.open(group.subject) as opened:
            for chosen in ([items[i] for i in telling([item.turned for item in items])], items[:SHARD_VIEWS]):
                photographs = []
                for item, sample, face in _faces(self.options, group.subject, opened, chosen, found):
                    if isinstance(face, Face):
                        photographs.append(_photograph(item, sample, face))
                    else:
                        why = str(face)
                if photographs:
                    break
        try:
            if not photographs:
                raise UserError(f"no face was found in the pictures that tell who {group.subject} is ({why})")
            found.person, found.fitted_from = fit_person(photographs, model)
        except UserError as error:
            found.failed |= {item.name: str(error) for item in items if item.name not in found.failed}
        return found


@dataclass(frozen=True)
class CaptureMaking:
    """The job of making captures of a group's pictures, which are written as one shard.

    Attributes:
        options: How.
        out: The folder, with its manifest.
    """

    options: PrepareOptions
    out: Folder

    @contextmanager
    def opened(self) -> Iterator[Callable[[Group, Tell], Found]]:
        """Open the data set and the head model."""
        require_shared(self.out / MANIFEST)
        with one_thread():
            yield partial(self._make, open_dataset(self.options.dataset, self.options.place), load_head_model())

    def _make(self, dataset: PublishedSet, model: HeadModel, group: Group, tell: Tell) -> Found:
        found, captures = Found(), list[Capture]()
        with dataset.open(group.subject) as opened:
            for item, sample, face in _faces(self.options, group.subject, opened, group.items, found):
                try:
                    capture, found.captures[item.name] = self._capture(model, group, item, sample, face)
                    captures.append(capture)
                except UserError as error:
                    found.failed[item.name] = str(error)
                tell()
        if captures:
            write_shard(self.out, captures)
        return found

    def _capture(
        self, model: HeadModel, group: Group, item: Listed, sample: Sample, face: Face | UserError
    ) -> tuple[Capture, dict[str, Any]]:
        if isinstance(face, UserError):
            raise face
        (fitted,) = fit_photographs([_photograph(item, sample, face)], model, known=group.person)
        focal = FOCAL_LENGTHS[self.options.dataset]
        return make_capture(sample, face, fitted, model, self.options.size, focal, group.number, item.number)


def _faces(
    options: PrepareOptions, subject: str, opened: SubjectPictures, items: Sequence[Listed], found: Found
) -> list[tuple[Listed, Sample, Face | UserError]]:
    """Pictures that can be read, with their faces; those that cannot be read are noted."""
    read = []
    for item in items:
        try:
            read.append((item, opened.read(item.number)))
        except UserError as error:
            found.failed[item.name] = str(error)
    faces = find_faces(options.files, subject, [(item.name, sample) for item, sample in read])
    return [(item, sample, face) for (item, sample), face in zip(read, faces, strict=True)]


def _photograph(item: Listed, sample: Sample, face: Face) -> Photograph:
    return Photograph(item.name, sample.pixels, face.landmarks, face.person, face.labels, sample.focal)
