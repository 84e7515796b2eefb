"""The captures that an estimator learns from, shard by shard, so that no more than their patches are in the memory."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from gazenerf.data.captures import Capture
from gazenerf.data.storage import read_shard
from gazenerf.errors import UserError
from gazenerf.geometry.labels import check_radians, unit_direction


def person_of(shard: Path) -> str:
    """The part of a shard's name that is one person's."""
    return shard.name.split("-view")[0]


def shards_of(folder: Path) -> list[Path]:
    """The shards of a folder of captures.

    Raises:
        UserError: there is none.
    """
    shards = sorted(folder.glob("person-*.npz"))
    if not shards:
        raise UserError(f"no captures in {folder}; make some with `gazenerf synthesize --out {folder}`")
    return shards


def split_shards(folder: Path, held_out: int) -> tuple[list[Path], list[Path]]:
    """The shards of people to learn from, and those of the last people, who are held out.

    Raises:
        UserError: nobody is left to learn from.
    """
    shards = shards_of(folder)
    people = sorted({person_of(path) for path in shards})
    kept = set(people[max(0, len(people) - held_out) :])
    learned = [path for path in shards if person_of(path) not in kept]
    if not learned:
        raise UserError(
            f"{folder} holds {len(people)} people and --held-out is {held_out}; nobody is left to learn from"
        )
    return learned, [path for path in shards if person_of(path) in kept]


def checked(shards: Sequence[Path]) -> Iterator[Capture]:
    """Captures, shard by shard.

    Raises:
        UserError: a gaze that cannot be radians, or a camera in the head's origin, from where no direction leads.
    """
    for shard in shards:
        captures = read_shard(shard)
        check_radians(np.array([[c.gaze.pitch, c.gaze.yaw] for c in captures]).reshape(-1, 2), f"a gaze in {shard}")
        for capture in captures:
            try:
                unit_direction(capture.camera.position, "the direction to the camera")
            except ValueError as error:
                raise UserError(f"{shard}, view {capture.view}: {error}") from error
            yield capture
