"""All cores at once: single-threaded torch in as many threads as there are cores.

Torch releases the interpreter while it computes, so threads can share one field in memory; one thread per
view is faster than several threads inside each matrix product.
"""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

import torch

from gazenerf.cores import usable_cores

MOST = 8


def cores() -> int:
    """Cores this process may use, at most `MOST`."""
    return min(MOST, usable_cores())


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
