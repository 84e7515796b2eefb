"""One person of a data set on the way to their captures."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from gazenerf.data.captures import Capture
from gazenerf.data.storage import SHARD_VIEWS, write_shard
from gazenerf.datasets.faces import Face, find_faces
from gazenerf.datasets.make_capture import make_capture
from gazenerf.datasets.options import PrepareOptions
from gazenerf.datasets.person_fit import fit_person, telling
from gazenerf.datasets.person_record import CAPTURE, PersonRecord
from gazenerf.datasets.published import Listed, Sample, SubjectPictures
from gazenerf.errors import UserError
from gazenerf.head_model.interface import HeadModel
from gazenerf.photographs.fit import Photograph, fit_photographs
from gazenerf.photographs.normalisation import FOCAL_LENGTHS

Say = Callable[[str], None]
"""Is told one line about each picture that fails."""


@dataclass(frozen=True)
class PersonPreparation:
    """What is needed to prepare one person.

    Attributes:
        options: How.
        out: Folder of the captures.
        model: The head model.
        number: Of the person.
        opened: Their pictures.
        record: What was done of them, which is brought up to date.
        say: Told about pictures that fail.
    """

    options: PrepareOptions
    out: Path
    model: HeadModel
    number: int
    opened: SubjectPictures
    record: PersonRecord
    say: Say

    def prepare(self, kept: Sequence[Listed]) -> Iterator[int]:
        """Yields how many pictures are done each time something is written."""
        for item in kept:
            if item.fault is not None and item.name not in self.record.pictures:
                self._fail(item.name, item.fault)
        left = [item for item in kept if item.name not in self.record.pictures]
        yield len(kept) - len(left)
        if left and self.record.person is None:
            try:
                self._fit_person(left)
            except UserError as error:
                for item in left:
                    self._fail(item.name, str(error))
                self.record.save()
                yield len(left)
                return
        for first in range(0, len(left), SHARD_VIEWS):
            group = left[first : first + SHARD_VIEWS]
            captures = self._captures(group)
            if captures:
                write_shard(self.out, captures)
            self.record.save()
            yield len(group)

    def _fit_person(self, items: Sequence[Listed]) -> None:
        """Fit identity and texture to telling pictures, or to the first ones where no face is found in those."""
        photographs: list[Photograph] = []
        why = "no picture can be read"
        for chosen in ([items[i] for i in telling([item.turned for item in items])], items[:SHARD_VIEWS]):
            for item, sample, face in self._faces(chosen):
                if isinstance(face, Face):
                    photographs.append(_photograph(item, sample, face))
                else:
                    why = str(face)
            if photographs:
                break
        else:
            raise UserError(f"no face was found in the pictures that tell who {self.record.subject} is ({why})")
        self.record.person, self.record.fitted_from = fit_person(photographs, self.model)
        self.record.save()

    def _captures(self, items: Sequence[Listed]) -> list[Capture]:
        captures = []
        for item, sample, face in self._faces(items):
            try:
                if isinstance(face, UserError):
                    raise face
                photograph = _photograph(item, sample, face)
                (fitted,) = fit_photographs([photograph], self.model, known=self.record.person)
                focal = FOCAL_LENGTHS[self.options.dataset]
                where = self.number, item.number
                capture, about = make_capture(sample, face, fitted, self.model, self.options.size, focal, *where)
            except UserError as error:
                self._fail(item.name, str(error))
                continue
            captures.append(capture)
            self.record.pictures[item.name] = {"became": CAPTURE, "view": item.number, **about}
        return captures

    def _faces(self, items: Sequence[Listed]) -> list[tuple[Listed, Sample, Face | UserError]]:
        """Pictures that can be read, with their faces; those that cannot be read are noted."""
        read = []
        for item in items:
            try:
                read.append((item, self.opened.read(item.number)))
            except UserError as error:
                self._fail(item.name, str(error))
        faces = find_faces(self.options.files, self.record.subject, [(item.name, sample) for item, sample in read])
        return [(item, sample, face) for (item, sample), face in zip(read, faces, strict=True)]

    def _fail(self, name: str, why: str) -> None:
        if name not in self.record.pictures:
            self.say(f"{self.record.subject} {name}: {why}")
        self.record.failed(name, why)


def _photograph(item: Listed, sample: Sample, face: Face) -> Photograph:
    return Photograph(item.name, sample.pixels, face.landmarks, face.person, face.labels, sample.focal)
