"""The workers of a running Dask cluster, through dask.distributed."""

from __future__ import annotations

import asyncio
import logging
import pydoc
import time
from collections.abc import Iterator
from concurrent.futures import CancelledError, Future
from contextlib import contextmanager
from functools import partial
from typing import Any

from gazenerf import __version__
from gazenerf.errors import UserError
from gazenerf.execution.job import CannotStart, Job, do
from gazenerf.execution.processes import keep_to_one_core

CONNECT_SECONDS = 10.0
"""How long a scheduler may take to answer."""

FETCH_SECONDS = 120.0
"""How long the result of an item may be on its way."""

WORKERS_SECONDS = 60.0
"""How long a run waits where there is no worker."""

EXTRA = 2
"""Items that wait at the scheduler beyond those that are worked on, for each worker."""


@contextmanager
def cluster(address: str) -> Iterator[Cluster]:
    """The workers of a scheduler; what was handed over and not begun is taken back when the block ends.

    Raises:
        UserError: dask.distributed is not installed, no scheduler answers, or its workers cannot be used.
    """
    try:
        from distributed import Client
    except ImportError as error:
        raise UserError("--scheduler needs dask.distributed: pip install 'gazenerf[cluster]'") from error
    for name in ("distributed", "tornado"):
        logging.getLogger(name).setLevel(logging.CRITICAL)  # what matters is said in one line by this module
    try:
        client = Client(address, timeout=CONNECT_SECONDS, set_as_default=False)
    except (OSError, ValueError, RuntimeError, TypeError) as error:
        raise UserError(
            f"no Dask scheduler answers at {address}; start one with `dask scheduler`, which prints its address, or "
            "leave --scheduler away"
        ) from error
    try:
        yield Cluster(client, address)
    finally:
        client.close(timeout=CONNECT_SECONDS)


class Cluster:
    """See `gazenerf.execution.results.Place`.

    Args:
        client: Connected.
        address: Of the scheduler.

    Raises:
        UserError: there are no workers, or they cannot be used.
    """

    def __init__(self, client: Any, address: str) -> None:
        self._client, self._address = client, address
        self._threads: dict[str, int] = {}
        self._looked, self._seen = 0.0, time.monotonic()
        self._known: set[str] = set()
        while not self._threads:
            self.look()
            time.sleep(0.0 if self._threads else 0.2)

    def call(self, job: Job[Any, Any], item: Any) -> Future[Any]:
        """Hand one item over; CancelledError is the result where the connection was lost.

        The executor of `Client.get_executor` would wait for ever for results that cannot be fetched.
        """
        ours: Future[Any] = Future()
        theirs = self._client.submit(_do_on_worker, __version__, job, item, pure=False)
        theirs.add_done_callback(partial(_pass_on, ours))
        return ours

    def room(self) -> int:
        """Some items for each worker, those that came lately among them."""
        if time.monotonic() - self._looked > 5.0:
            self.look()
        return max(1, (1 + EXTRA) * len(self._threads))

    def again(self) -> bool:
        """Dask hands what dead workers were at to others by itself."""
        return False

    def look(self) -> None:
        """Ask the scheduler for its workers, and look at those that are new."""
        try:
            if self._client.status != "running":
                raise OSError(f"the connection is {self._client.status}")
            self._threads = dict(self._client.nthreads())
            self._check([worker for worker in self._threads if worker not in self._known])
        except UserError:
            raise
        except Exception as error:
            raise UserError(
                f"the Dask scheduler at {self._address} is gone; start it and its workers again, and the same command "
                "goes on where it stopped"
            ) from error
        now = time.monotonic()
        self._looked, self._seen = now, now if self._threads else self._seen
        if now - self._seen > WORKERS_SECONDS:
            raise UserError(
                f"the Dask scheduler at {self._address} has no workers; start some with "
                f"`dask worker {self._address} --nthreads 1 --nworkers N`, and run the same command again"
            )

    def _check(self, workers: list[str]) -> None:
        """Refuse workers that do several things at once, or have another gazenerf or none."""
        for worker in workers:
            if self._threads[worker] != 1:
                raise UserError(
                    f"the worker {worker} does {self._threads[worker]} things at once, which renderers do not bear; "
                    f"start it with `dask worker {self._address} --nthreads 1 --nworkers N`"
                )
        if workers:
            found = self._client.run(pydoc.locate, "gazenerf.__version__", workers=workers, on_error="return")
            for worker, version in found.items():
                _refuse_version(worker, version)
            self._known |= set(found)


def _pass_on(ours: Future[Any], theirs: Any) -> None:
    try:
        result = theirs.result(timeout=FETCH_SECONDS)
    except (OSError, TimeoutError, CancelledError, asyncio.CancelledError):
        ours.set_exception(CancelledError())  # what fails in a job is none of these
    except BaseException as error:
        ours.set_exception(error)
    else:
        ours.set_result(result)


def _refuse_version(worker: str, version: object) -> None:
    if isinstance(version, OSError):
        return  # it went away meanwhile
    if version != __version__:
        has = "has no gazenerf" if version is None else f"has gazenerf {version}"
        if isinstance(version, Exception):
            has = f"cannot load gazenerf ({' '.join(str(version).split())[:120]})"
        raise CannotStart(
            f"the worker {worker} {has}, here it is {__version__}; install the same version there and start it again"
        )


def _do_on_worker(version: str, job: Job[Any, Any], item: Any) -> Any:
    """In a worker's thread."""
    _refuse_version("that took an item", version)
    keep_to_one_core()
    return do(job, item, lambda: None)
