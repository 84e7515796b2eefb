"""Where a step runs: one device through torch, several through Lightning Fabric."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterator
from typing import Any

import torch
from torch import nn

from gazenerf.devices import choose_device
from gazenerf.errors import UserError
from gazenerf.training.operations import FUSED, REFERENCE, Operations, compiled
from gazenerf.training.optimizers import Optimizers

COMPILE = ("auto", "on", "off")


def fast_bfloat16(device: torch.device) -> bool:
    """Whether bfloat16 matrix products pay on a device: any recent GPU, a CPU with matrix tiles."""
    if device.type == "cuda":
        return torch.cuda.is_bf16_supported()
    supported = getattr(torch.cpu, "_is_amx_tile_supported", lambda: False)
    return bool(supported())


def started_by_launcher(devices: int, nodes: int) -> tuple[int, int]:
    """Devices on each machine, and machines, as the launcher of this process says, else as they were asked for.

    Raises:
        UserError: impossible ones, others than the launcher says, or SLURM started several processes that nobody
            asked for, which would all write the same run.
    """
    if devices < 1 or nodes < 1:
        raise UserError(f"--devices and --nodes must be at least 1, got {devices} and {nodes}")
    if "TORCHELASTIC_RUN_ID" in os.environ:  # torchrun, and fabric run, which is torchrun
        here, world = int(os.environ["LOCAL_WORLD_SIZE"]), int(os.environ["WORLD_SIZE"])
        if (devices, nodes) not in ((1, 1), (here, world // here)):
            raise UserError(
                f"the launcher started {here} processes on each of {world // here} machines, not --devices {devices} "
                f"--nodes {nodes}; leave --devices and --nodes away"
            )
        return here, world // here
    tasks = int(os.environ.get("SLURM_STEP_NUM_TASKS", "1"))
    if tasks > 1 and tasks != devices * nodes:
        raise UserError(
            f"srun started {tasks} processes; give --devices (those on each machine) and --nodes (machines) whose "
            "product that is"
        )
    return devices, nodes


class Runtime:
    """Moves, casts and steps an objective on one device or several.

    Args:
        device: `auto`, `cpu` or `cuda`.
        devices: How many on this machine; where `torchrun` or `fabric run` started this process, they say it.
        nodes: How many machines; the same.
        precision: `auto`, `float32` or `bfloat16`.
        compile: Run the heavy operations through `torch.compile`: `auto` does so on one GPU.

    Attributes:
        fused: Use the fused operations and optimisers; on a GPU.
        compile: As decided.

    Raises:
        UserError: the device is not there, several were asked for without Lightning Fabric, or other ones than were
            started.
    """

    def __init__(
        self,
        device: str = "auto",
        devices: int = 1,
        precision: str = "auto",
        compile: str = "auto",
        nodes: int = 1,
    ) -> None:
        chosen = choose_device(device)
        self.fabric: Any = None
        self.rank, self.world = 0, 1
        devices, nodes = started_by_launcher(devices, nodes)
        if devices * nodes > 1:
            try:
                from lightning.fabric import Fabric  # pyright: ignore[reportMissingImports]
            except ImportError as error:
                raise UserError("training on several devices needs: pip install gazenerf[multi-gpu]") from error
            self.fabric = Fabric(accelerator=chosen.type, devices=devices, num_nodes=nodes)
            if os.environ.get("LT_CLI_USED") != "1":  # `fabric run` has launched it, and refuses a second time
                self.fabric.launch()
            self.rank, self.world = int(self.fabric.global_rank), int(self.fabric.world_size)
            self.device = torch.device(self.fabric.device)
        else:
            unnumbered = chosen.type == "cuda" and chosen.index is None
            self.device = torch.device("cuda", torch.cuda.current_device()) if unnumbered else chosen
        if precision not in ("auto", "float32", "bfloat16"):
            raise UserError(f"unknown precision {precision!r}; use auto, float32 or bfloat16")
        if compile not in COMPILE:
            raise UserError(f"unknown compile {compile!r}; use {', '.join(COMPILE)}")
        if compile == "on" and self.world > 1:
            raise UserError("compiled operations need one device; leave --compile at auto or lower --devices to 1")
        self.compile = compile == "on" or (compile == "auto" and self.device.type == "cuda" and self.world == 1)
        self.fused = self.device.type == "cuda"
        if self.device.type == "cuda":
            torch.backends.cudnn.benchmark = True
            if precision != "float32":
                torch.set_float32_matmul_precision("high")
        self.bfloat16 = precision == "bfloat16" or (precision == "auto" and fast_bfloat16(self.device))

    def operations(self) -> Operations:
        """How a step is computed here, before `torch.compile` and without."""
        return FUSED if self.fused or self.compile else REFERENCE

    def compiled_operations(self) -> Operations:
        """`operations`, compiled where that is wanted."""
        return compiled(self.operations()) if self.compile else self.operations()

    def join_thread(self) -> None:
        """Make this runtime's device the present one of the calling thread."""
        if self.device.type == "cuda":
            torch.cuda.set_device(self.device)

    def place(self, function: Any) -> Any:
        """A frozen network on this device; any other function as it is."""
        return function.to(self.device) if isinstance(function, nn.Module) else function

    def agree(self, value: float) -> float:
        """The first process's value, so that all do the same whatever their clocks say."""
        return value if self.fabric is None else float(self.fabric.broadcast(value))

    def mean(self, values: torch.Tensor) -> torch.Tensor:
        """Numbers (N,) averaged over processes, the same in all of them."""
        return values if self.fabric is None else self.fabric.all_reduce(values, reduce_op="mean")

    def reading(self, values: torch.Tensor) -> Callable[[], list[float]]:
        """Numbers (N,) on their way to the host; a call waits for what made them, not for what is queued after."""
        if values.device.type != "cuda":
            return values.tolist
        on_host = torch.empty(values.shape, dtype=values.dtype, pin_memory=True)
        on_host.copy_(values, non_blocking=True)
        arrived = torch.cuda.Event()
        arrived.record()

        def read() -> list[float]:
            arrived.synchronize()
            return on_host.tolist()

        return read

    def setup(self, objective: nn.Module, optimizers: Optimizers) -> nn.Module:
        """The objective, wrapped for this runtime; the optimisers are wrapped in place."""
        if self.fabric is None:
            return objective.to(self.device)
        wrapped, *optimizers.members = self.fabric.setup(objective, *optimizers.members)
        return wrapped

    @contextlib.contextmanager
    def autocast(self) -> Iterator[None]:
        """Mixed precision where it pays."""
        with torch.autocast(self.device.type, dtype=torch.bfloat16, enabled=self.bfloat16):
            yield

    def backward(self, loss: torch.Tensor) -> None:
        """Gradients of a loss, averaged over devices."""
        if self.fabric is None:
            loss.backward()
        else:
            self.fabric.backward(loss)
