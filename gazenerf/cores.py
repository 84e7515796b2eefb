"""How many things can be done at once here, and on what processor."""

from __future__ import annotations

import os
import platform
from pathlib import Path

_most: int | None = None


def use_at_most(cores: int) -> None:
    """Leave the other cores to the processes beside this one."""
    global _most
    _most = cores


def usable_cores() -> int:
    """Cores this process may use, at least 1."""
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return max(1, min(usable or 1, _most or usable or 1))


def processor_name() -> str:
    """The processor's model, as well as it is known."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        lines = []
    named = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return named[0] if named else platform.processor()
