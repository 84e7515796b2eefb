"""All cores at once: single-threaded torch in as many threads as there are cores.

Torch releases the interpreter while it computes, so threads can share one field in memory; one thread per
view is faster than several threads inside each matrix product.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from typing import TypeVar

import torch

from gazenerf.cores import usable_cores

Item = TypeVar("Item")
Result = TypeVar("Result")

MOST = 8


def cores() -> int:
    """Cores this process may use, at most `MOST`."""
    return min(MOST, usable_cores())


def workers_for(device: torch.device) -> int:
    """Threads that compute on a device at once: one a core on a CPU, one on a GPU, which is kept busy by one."""
    return cores() if device.type == "cpu" else 1


@contextmanager
def one_thread() -> Iterator[None]:
    """Within the block torch computes in one thread, so that sums have the same last bits on any number of cores."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


@contextmanager
def pool(workers: int | None = None) -> Iterator[ThreadPoolExecutor]:
    """An executor whose threads run torch on one core each; torch's own threads come back afterwards.

    Args:
        workers: How many; `cores()` by default.
    """
    before = torch.get_num_threads()
    executor = ThreadPoolExecutor(workers or cores(), initializer=lambda: torch.set_num_threads(1))
    try:
        yield executor
    finally:
        executor.shutdown(wait=True, cancel_futures=True)
        torch.set_num_threads(before)


def in_order(
    executor: ThreadPoolExecutor, make: Callable[[Item], Result], items: Iterable[Item], ahead: int
) -> Iterator[Result]:
    """What `make` gives for each item, in their order, so many of them at a time.

    Unlike `ThreadPoolExecutor.map`, items are taken and results held only as the caller goes on.

    Args:
        executor: Where `make` runs.
        make: Safe to run in several threads.
        items: Taken in the caller's thread.
        ahead: Results that are made or wait at any time, at least 1.
    """
    running: deque[Future[Result]] = deque()
    for item in items:
        running.append(executor.submit(make, item))
        if len(running) >= ahead:
            yield running.popleft().result()
    while running:
        yield running.popleft().result()
