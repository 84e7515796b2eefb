"""How many things can be done at once here."""

from __future__ import annotations

import os

_most: int | None = None


def use_at_most(cores: int) -> None:
    """Leave the other cores to the processes beside this one."""
    global _most
    _most = cores


def usable_cores() -> int:
    """Cores this process may use, at least 1."""
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return max(1, min(usable or 1, _most or usable or 1))
