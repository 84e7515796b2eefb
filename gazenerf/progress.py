"""How long computations tell what they are doing."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Protocol, TypeVar

T = TypeVar("T")


class Progress(Protocol):
    """Called with what is being done, how many steps of it are done, and how many there are."""

    def __call__(self, stage: str, done: int, total: int, /) -> None: ...


def silent(stage: str, done: int, total: int, /) -> None:
    """A `Progress` that tells nobody."""


def counted(items: Iterable[T], progress: Progress, stage: str, total: int) -> Iterator[T]:
    """The items, one after another; `progress` is told after each was used."""
    for done, item in enumerate(items, 1):
        yield item
        progress(stage, done, total)


def steps_of(progress: Progress, stage: str) -> Callable[[int, int], None]:
    """The progress of one stage, called with (done, total)."""
    return lambda done, total: progress(stage, done, total)


def advancing(progress: Progress, stage: str, done: int, total: int) -> Callable[[int], None]:
    """The progress of one stage of which so many steps are done, called with how many more are."""

    def advance(steps: int) -> None:
        nonlocal done
        done += steps
        progress(stage, done, total)

    return advance
