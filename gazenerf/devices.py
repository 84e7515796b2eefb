"""Which device computes, in which precision, and how much at once."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import torch

from gazenerf.errors import UserError

DEVICES = ("auto", "cpu", "cuda")

PRECISIONS = ("auto", "float32", "float16", "bfloat16")
"""Of matrix products; `auto` is float16 on a GPU and float32 on a CPU.

Against float32, 256 px pictures of the bundled portrait field agree to 65 dB in float16 and 58 dB in bfloat16; depths
differ by 0.002 and 0.02 mm (median), 0.03 and 0.2 mm (99th percentile). Measured on a CPU.
"""

CPU_CHUNK = 2**13
"""Points queried at once on a CPU. Larger arrays come fresh from the system every time, which costs a third of the
time."""

GPU_CHUNK = 2**19
"""Points queried at once on a GPU: about 3 GB for the published field."""


def choose_device(name: str | torch.device = "auto") -> torch.device:
    """A device by name: `auto` is a CUDA GPU where PyTorch sees one, else the CPU.

    Raises:
        UserError: an unknown name, or PyTorch sees no such device.
    """
    if isinstance(name, torch.device):
        return name
    kind, _, number = name.partition(":")
    if kind not in DEVICES or (number and not number.isdigit()):
        raise UserError(f"unknown device {name!r}; choose {', '.join(DEVICES)}")
    if kind == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    if kind == "cuda":
        if not torch.cuda.is_available():
            raise UserError(f"PyTorch sees no CUDA device ({_why_no_cuda()}); use --device cpu")
        if number and int(number) >= torch.cuda.device_count():
            raise UserError(f"there is no {name}; PyTorch sees {torch.cuda.device_count()} CUDA devices, cuda:0 first")
    return torch.device(name)


def _why_no_cuda() -> str:
    if torch.version.cuda is None:
        return "this build of PyTorch is for CPUs; install one with CUDA"
    return f"it is built for CUDA {torch.version.cuda}; `nvidia-smi` tells whether a driver is running"


def product_dtype(precision: str, device: torch.device) -> torch.dtype:
    """The type of matrix products.

    Raises:
        UserError: an unknown precision.
    """
    if precision not in PRECISIONS:
        raise UserError(f"unknown precision {precision!r}; choose {', '.join(PRECISIONS)}")
    if precision == "auto":
        return torch.float16 if device.type == "cuda" else torch.float32
    return {"float32": torch.float32, "float16": torch.float16, "bfloat16": torch.bfloat16}[precision]


def points_at_once(device: torch.device) -> int:
    """Points to query at once."""
    return CPU_CHUNK if device.type == "cpu" else GPU_CHUNK


def is_out_of_memory(error: BaseException) -> bool:
    """Whether an error says that a GPU has no memory left, in the framework's words or a library's."""
    if isinstance(error, torch.OutOfMemoryError):
        return True
    return isinstance(error, RuntimeError) and any(text in str(error) for text in ("out of memory", "ALLOC_FAILED"))


def free_memory(device: torch.device) -> int | None:
    """Bytes of a GPU's memory that PyTorch can still hand out, None for a CPU."""
    if device.type != "cuda" or not torch.cuda.is_available():
        return None
    free, _ = torch.cuda.mem_get_info(device)
    return free + torch.cuda.memory_reserved(device) - torch.cuda.memory_allocated(device)


@dataclass
class WatchedMemory:
    """What a computation took of a GPU's memory.

    Attributes:
        most: Bytes at the time it held most, beyond what was held before; None for a CPU.
    """

    most: int | None = None


@contextmanager
def watch_memory(device: torch.device) -> Iterator[WatchedMemory]:
    """Watches what the block takes of a GPU's memory; PyTorch's own peak is counted from here on."""
    watched = WatchedMemory()
    if device.type != "cuda" or not torch.cuda.is_available():
        yield watched
        return
    torch.cuda.reset_peak_memory_stats(device)
    before = torch.cuda.memory_allocated(device)
    yield watched
    watched.most = torch.cuda.max_memory_allocated(device) - before


def release_memory() -> None:
    """Give memory that PyTorch keeps for later back to the GPU, where there is one."""
    if torch.cuda.is_available():
        torch.cuda.empty_cache()
