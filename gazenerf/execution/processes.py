"""Processes that each keep to one core, leave Ctrl-C to the process that started them, and do not outlive it."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from gazenerf.cores import use_at_most

ONE_CORE = {"OMP_NUM_THREADS": "1", "LP_NUM_THREADS": "1"}
"""What keeps NumPy's matrix products, torch, and Mesa's software rasterizer to one thread; read as they load."""


@contextmanager
def launching() -> Iterator[None]:
    """Processes started within the block keep to one core and are deaf to Ctrl-C from their first moment.

    Ctrl-C in this process is heard when the block ends. Where signals cannot be held back, only `follow_parent` makes
    the processes deaf.
    """
    before = {name: os.environ.get(name) for name in ONE_CORE}
    held = hasattr(signal, "pthread_sigmask")
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT}) if held else set()
    os.environ.update(ONE_CORE)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
        if held:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)


def keep_to_one_core() -> None:
    """Let whatever this process computes keep to one core, as its neighbours on the other cores do.

    Libraries that were not loaded read the environment as they load; OpenCV does not, so call this before each item.
    """
    os.environ.update(ONE_CORE)
    use_at_most(1)
    for library, limit in (("torch", "set_num_threads"), ("cv2", "setNumThreads")):
        if library in sys.modules:
            getattr(sys.modules[library], limit)(1)


def follow_parent() -> None:
    """Leave Ctrl-C to the parent, and end at once when the parent is gone, however it went."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    assert parent is not None, "only processes started by another call this"

    def wait() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=wait, daemon=True).start()
