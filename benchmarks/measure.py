"""What the benchmarks share: paired timing, memory, operations, the machine, the result file."""

from __future__ import annotations

import json
import os
import platform
import statistics
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import torch
from torch.utils.flop_counter import FlopCounterMode

from gazenerf.cores import processor_name
from gazenerf.files import whole_file


def timed(call: Callable[[], Any]) -> float:
    """Wall seconds of one call."""
    started = time.perf_counter()
    call()
    return time.perf_counter() - started


def paired(calls: Mapping[str, Callable[[], Any]], rounds: int, warm: int = 1) -> dict[str, list[float]]:
    """Seconds of each call, all called in turn in every round, so that what else the machine does hits all alike."""
    seconds: dict[str, list[float]] = {name: [] for name in calls}
    for number in range(rounds + warm):
        for name, call in calls.items():
            taken = timed(call)
            if number >= warm:
                seconds[name].append(taken)
    return seconds


def ratio(slow: list[float], fast: list[float]) -> float:
    """Median over rounds of slow / fast."""
    return statistics.median(a / b for a, b in zip(slow, fast, strict=True))


def flops(call: Callable[[], Any]) -> int:
    """Floating-point operations of the matrix products and convolutions of a call."""
    with FlopCounterMode(display=False) as counter:
        call()
    return counter.get_total_flops()


def matrix_rate(size: int = 2048, rounds: int = 7) -> float:
    """Operations a second of the machine's float32 matrix product, the best of some rounds."""
    a = torch.rand(size, size)
    return 2.0 * size**3 / min(timed(lambda: a @ a) for _ in range(rounds))


def peak_memory(call: Callable[[], Any]) -> int | None:
    """Bytes by which a call raises the process's memory at its peak; None where the system does not tell."""
    clear, status = Path("/proc/self/clear_refs"), Path("/proc/self/status")
    try:
        clear.write_text("5")
        before = _status(status, "VmRSS")
        call()
        return max(0, _status(status, "VmHWM") - before)
    except OSError:
        return None


def resident() -> int | None:
    """Bytes of memory that the process holds; None where the system does not tell."""
    try:
        return _status(Path("/proc/self/status"), "VmRSS")
    except OSError:
        return None


def _status(path: Path, name: str) -> int:
    line = next(line for line in path.read_text().splitlines() if line.startswith(name))
    return 1024 * int(line.split()[1])


def machine() -> dict[str, Any]:
    """What the numbers were measured on."""
    return {
        "processor": processor_name(),
        "architecture": platform.machine(),
        "cores": os.cpu_count(),
        "threads": torch.get_num_threads(),
        "load": round(os.getloadavg()[0], 1) if hasattr(os, "getloadavg") else None,
        "torch": torch.__version__,
        "gpu": None,
    }


def write_json(path: Path | None, result: dict[str, Any]) -> None:
    """Write a result if asked to."""
    if path is not None:
        with whole_file(path) as temporary:
            temporary.write_text(json.dumps(result, indent=2) + "\n")


def exponent(x: list[float], y: list[float]) -> float:
    """Slope of a straight line through log x, log y."""
    u, v = torch.tensor(x).double().log(), torch.tensor(y).double().log()
    u = u - u.mean()
    return float((u * (v - v.mean())).sum() / u.square().sum())
