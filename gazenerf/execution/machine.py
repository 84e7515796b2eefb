"""Processes of this machine."""

from __future__ import annotations

import atexit
import ctypes
import multiprocessing
from collections.abc import Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager
from typing import Any

from gazenerf.execution.job import Job, Stopped, close_job, do
from gazenerf.execution.processes import follow_parent, keep_to_one_core, launching

MOST_DEATHS = 1
"""So often processes may die in a run before it ends."""


@contextmanager
def machine(workers: int) -> Iterator[Machine]:
    """So many processes; however the block ends, they end after the step they are at."""
    place = Machine(workers)
    try:
        yield place
    finally:
        place.close()


class Machine:
    """See `gazenerf.execution.results.Place`.

    Args:
        workers: Processes.
    """

    def __init__(self, workers: int) -> None:
        self._workers, self._deaths = workers, 0
        self._context = multiprocessing.get_context("spawn")
        self._stop = self._context.RawValue(ctypes.c_bool, False)  # no lock, which a process that dies could take along
        self._start()

    def _start(self) -> None:
        self._executor = ProcessPoolExecutor(
            self._workers, self._context, initializer=_start_process, initargs=(self._stop,)
        )

    def call(self, job: Job[Any, Any], item: Any) -> Future[Any]:
        """Hand one item over."""
        with launching():
            return self._executor.submit(_do_in_process, job, item)

    def room(self) -> int:
        """One item for each process, and one that waits."""
        return 2 * self._workers

    def look(self) -> None:
        """Processes that died say so themselves."""

    def again(self) -> bool:
        """Start processes anew, unless too many died."""
        self._deaths += 1
        self._executor.shutdown(cancel_futures=True)
        if self._deaths > MOST_DEATHS:
            return False
        self._start()
        return True

    def close(self) -> None:
        """End the processes."""
        self._stop.value = True
        self._executor.shutdown(cancel_futures=True)


_stop: ctypes.c_bool | None = None


def _start_process(stop: ctypes.c_bool) -> None:
    global _stop
    follow_parent()
    _stop = stop
    atexit.register(close_job)


def _do_in_process(job: Job[Any, Any], item: Any) -> Any:
    def tell() -> None:
        if _stop is not None and _stop.value:
            raise Stopped

    tell()
    keep_to_one_core()
    return do(job, item, tell)
