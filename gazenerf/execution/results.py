"""The results of many items as they are done, whatever does them."""

from __future__ import annotations

from collections.abc import Callable, Collection, Generator, Iterator
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager
from dataclasses import dataclass
from itertools import chain, islice
from typing import Any, Generic, Protocol, TypeVar

from gazenerf.errors import UserError
from gazenerf.execution.job import CannotStart, Job
from gazenerf.execution.options import Where

Item = TypeVar("Item")
Result = TypeVar("Result")

POLL_SECONDS = 2.0
"""How often a place is asked whether it is still there, while nothing is done."""


@dataclass(frozen=True)
class Done(Generic[Item, Result]):
    """What became of an item.

    Attributes:
        item: It.
        error: Why there is no result, None where there is one.
    """

    item: Item
    error: Exception | None
    _result: Result | None = None

    @property
    def result(self) -> Result:
        """What the job gave.

        Raises:
            Exception: `error`.
        """
        if self.error is not None:
            raise self.error
        return self._result  # pyright: ignore[reportReturnType]


class Place(Protocol):
    """Where jobs run: around an executor of `concurrent.futures`."""

    def call(self, job: Job[Any, Any], item: Any) -> Future[Any]:
        """Hand one item over."""
        ...

    def room(self) -> int:
        """Items that may be handed over at any time, at least 1."""
        ...

    def look(self) -> None:
        """Raise UserError where the place is gone."""
        ...

    def again(self) -> bool:
        """After processes died: whether what they were at can be handed over once more."""
        ...


def results(
    job: Job[Item, Result],
    items: Collection[Item],
    where: Where,
    *,
    size: Callable[[Item], int] = lambda _: 1,
    advance: Callable[[int], None] = lambda _: None,
) -> Generator[Done[Item, Result], None, None]:
    """Do a job to items, in any order; close the generator to end early, and everything that works ends.

    Items are handed over a few at a time, so they may be large. An item that fails does not end the others: where the
    job runs in the calling thread that holds for UserError alone, so that a bug shows where it is.

    Args:
        job: What is done.
        items: To these.
        where: By whom.
        size: Steps in an item.
        advance: Told of steps: of each, where the job runs in the calling thread, else of all of an item at once.

    Raises:
        UserError: the job cannot start, processes died, or a cluster is not there (any more).
    """
    if not items:
        return
    if where.scheduler is None and min(where.workers, len(items)) == 1:
        yield from _in_turn(job, items, size, advance)
        return
    with _place(where, len(items)) as place:
        for done in _side_by_side(job, items, place):
            advance(size(done.item))
            yield done


def _in_turn(
    job: Job[Item, Result], items: Collection[Item], size: Callable[[Item], int], advance: Callable[[int], None]
) -> Generator[Done[Item, Result], None, None]:
    told = 0

    def tell() -> None:
        nonlocal told
        told += 1
        advance(1)

    with job.opened() as work:
        for item in items:
            told = 0
            try:
                done = Done(item, None, work(item, tell))
            except UserError as error:
                done: Done[Item, Result] = Done(item, error)
            if left := size(item) - told:
                advance(left)
            yield done


def _place(where: Where, items: int) -> AbstractContextManager[Place]:
    if where.scheduler is not None:
        from gazenerf.execution.cluster import cluster

        return cluster(where.scheduler)
    from gazenerf.execution.machine import machine

    return machine(min(where.workers, items))


def _side_by_side(
    job: Job[Item, Result], items: Collection[Item], place: Place
) -> Generator[Done[Item, Result], None, None]:
    waiting: Iterator[Item] = iter(items)
    running: dict[Future[Result], Item] = {}
    while True:
        for item in islice(waiting, max(0, place.room() - len(running))):
            running[place.call(job, item)] = item
        if not running:
            return
        finished, _ = wait(running, timeout=POLL_SECONDS, return_when=FIRST_COMPLETED)
        if not finished:
            place.look()
        lost: list[Item] = []
        for future in finished:
            item = running.pop(future)
            try:
                done = Done(item, None, future.result())
            except BrokenProcessPool:
                lost.append(item)
                continue
            except CannotStart:
                raise
            except CancelledError as error:
                place.look()
                raise UserError(
                    "the connection to the cluster was lost; the same command goes on from there"
                ) from error
            except Exception as error:
                done: Done[Item, Result] = Done(item, error)
            yield done
        if lost:
            lost += running.values()
            running.clear()
            if not place.again():
                raise UserError(
                    "a process died, perhaps for want of memory; the same command with a smaller --workers goes on "
                    "where it stopped"
                )
            waiting = chain(lost, waiting)
