"""How many things can be done at once here."""

from __future__ import annotations

import os


def usable_cores() -> int:
    """Cores this process may use, at least 1."""
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return max(1, usable or 1)
