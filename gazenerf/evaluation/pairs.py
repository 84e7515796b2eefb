"""Which captures redirections start from and where they are to arrive: drawn once, saved, the same for every field.

Each readable capture of a subject is used once: half of them, at random, are sources, the other half their targets,
as the published evaluation pairs 200 pictures a subject.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gazenerf.data.captures import Capture
from gazenerf.errors import UserError
from gazenerf.files import read_json, whole_file
from gazenerf.training.gaze_training import readable

FORMAT = "gazenerf-pairs-1"
MAX_BYTES = 16 * 2**20
DIGITS = 6
"""Decimals of gazes and cameras that tell captures apart."""

FIX = "give the --pairs that were drawn for this data, or a new file name to draw others"


@dataclass(frozen=True)
class Pair:
    """A redirection.

    Attributes:
        person: Index.
        source, target: Views of that person.
    """

    person: int
    source: int
    target: int

    @property
    def name(self) -> str:
        """Unique among the pairs of a set."""
        return f"person {self.person} view {self.source} to {self.target}"


@dataclass(frozen=True)
class Pairs:
    """The pairs of a data set.

    Attributes:
        data: `identities_hash` of the captures that they are of.
        seed: They were drawn with.
        pairs: By person, in the order in which they were drawn.
    """

    data: str
    seed: int
    pairs: tuple[Pair, ...]

    @property
    def people(self) -> list[int]:
        """Whose they are, ascending."""
        return sorted({pair.person for pair in self.pairs})

    @property
    def hash(self) -> str:
        """SHA-256 of which pairs they are, 16 digits; equal for equal pairs of equal data."""
        return _digest([self.data, [[pair.person, pair.source, pair.target] for pair in self.pairs]])

    def first(self, most: int | None) -> list[Pair]:
        """At most so many of each person; all where that is None."""
        return [pair for person in self.people for pair in [p for p in self.pairs if p.person == person][:most]]


def identities_hash(captures: Sequence[Capture]) -> str:
    """SHA-256, 16 digits, of who and what captures show: person, view, gaze and camera of each, whatever the order."""
    shown = sorted(
        [
            capture.person,
            capture.view,
            *(round(float(angle), DIGITS) for angle in (capture.gaze.pitch, capture.gaze.yaw)),
            *(round(float(number), DIGITS) for number in capture.camera.intrinsics.reshape(-1)),
            *(round(float(number), DIGITS) for number in capture.camera.world_from_camera.reshape(-1)),
            capture.camera.width,
            capture.camera.height,
        ]
        for capture in captures
    )
    return _digest(shown)


def _digest(value: Any) -> str:
    return hashlib.sha256(json.dumps(value).encode()).hexdigest()[:16]


def draw_pairs(captures: Sequence[Capture], people: Sequence[int], seed: int) -> Pairs:
    """Pairs of some people; the same arguments give the same pairs.

    Args:
        captures: All of the data set.
        people: Whose captures are paired; people with fewer than two that show enough of an eye get no pair.
        seed: 0 or more.

    Raises:
        UserError: nobody has two captures that show an eye.
    """
    drawn: list[Pair] = []
    for person in people:
        views = sorted(capture.view for capture in captures if capture.person == person and readable(capture))
        order = np.random.default_rng((seed, person)).permutation(views)
        half = len(views) // 2
        drawn += [Pair(person, int(a), int(b)) for a, b in zip(order[:half], order[half : 2 * half], strict=True)]
    if not drawn:
        raise UserError("no person to measure has two captures that show an eye; give captures from the front")
    return Pairs(identities_hash(captures), seed, tuple(drawn))


def save_pairs(pairs: Pairs, path: Path) -> None:
    """Write pairs as JSON: `format`, `data`, `seed` and `pairs`, person to [source view, target view]."""
    by_person = {str(person): [] for person in pairs.people}
    for pair in pairs.pairs:
        by_person[str(pair.person)].append([pair.source, pair.target])
    written = {"format": FORMAT, "data": pairs.data, "seed": pairs.seed, "pairs": by_person}
    with whole_file(path) as temporary:
        temporary.write_text(json.dumps(written) + "\n", encoding="utf-8")


def load_pairs(path: Path, captures: Sequence[Capture], people: Sequence[int]) -> Pairs:
    """Read pairs that were drawn for these captures.

    Args:
        path: What `save_pairs` wrote.
        captures: All of the data set.
        people: Who may be measured.

    Raises:
        UserError: it cannot be read, is of other data, names captures that are not there, or people that may not be
            measured.
    """
    said = read_json(path, MAX_BYTES, absent="it is drawn by the same command without it", large=FIX)
    if not isinstance(said, dict) or said.get("format") != FORMAT:
        raise UserError(f"{path} is not a file of pairs; {FIX}")
    data = identities_hash(captures)
    if said.get("data") != data:
        raise UserError(f"{path} pairs the captures of other data ({said.get('data')}, not {data}); {FIX}")
    try:
        found = tuple(
            Pair(int(person), _index(source), _index(target))
            for person, pairs in said["pairs"].items()
            for source, target in pairs
        )
        seed = _index(said["seed"])
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise UserError(f"{path} is damaged ({' '.join(str(error).split())[:80]}); {FIX}") from error
    known = {(capture.person, capture.view) for capture in captures}
    for pair in found:
        if not {(pair.person, pair.source), (pair.person, pair.target)} <= known or pair.source == pair.target:
            raise UserError(f"{path} is damaged ({pair.name} are no two captures of {data}); {FIX}")
    if not found or len(set(found)) != len(found):
        raise UserError(f"{path} is damaged ({'a pair is there twice' if found else 'it holds no pair'}); {FIX}")
    if strangers := sorted({pair.person for pair in found} - set(people)):
        raise UserError(f"{path} pairs captures of person {strangers[0]}, who is not held out; raise --held-out")
    return Pairs(data, seed, found)


def _index(value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise ValueError(f"{value!r} is no index")
    return value
