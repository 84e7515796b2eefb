"""The batch of every step, from captures that are kept where they fit."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np
import torch

from gazenerf.devices import is_out_of_memory, release_memory
from gazenerf.training.batches import FREE_RAYS, Batch, BatchMaker
from gazenerf.training.config import TrainConfig
from gazenerf.training.device_batches import DeviceBatchMaker, device_bytes
from gazenerf.training.runtime import Runtime

AHEAD = 2
"""Batches that a background thread prepares before they are asked for."""

DEVICE_SHARE = 0.5
"""Of a GPU's free memory that captures may take; the rest is for the step."""


def draw(pictures: int, per_step: int, step: int, seed: int) -> tuple[int, list[int]]:
    """Epoch and picture indices of a step: each epoch visits every picture once, in seeded order."""
    first = step * per_step
    chosen = []
    for position in range(first, first + per_step):
        epoch, place = divmod(position, pictures)
        order = np.random.default_rng((seed, 7, epoch)).permutation(pictures)
        chosen.append(int(order[place]))
    return first // pictures, chosen


class Feed:
    """Batches of this process's share of each step, the same wherever the captures are.

    Args:
        maker: Captures in main memory.
        config: Pictures per step, and the seed.
        runtime: Device, rank and number of processes.
        say: Told once, in a line, where captures had to stay in main memory.
        held: `device`: captures lie there and batches are gathered there; `ahead`: a background thread
            prepares batches in pinned main memory; `host`: as they are needed. By default the first that
            fits on a GPU, and `host` on a CPU.
    """

    def __init__(
        self,
        maker: BatchMaker,
        config: TrainConfig,
        runtime: Runtime,
        say: Callable[[str], None] = lambda text: None,
        held: str | None = None,
    ) -> None:
        self._host, self._config, self._runtime, self._say = maker, config, runtime, say
        self._maker: BatchMaker | DeviceBatchMaker = maker
        self._waiting: dict[int, Future[tuple[int, Batch]]] = {}
        self._thread: ThreadPoolExecutor | None = None
        self.held = "host"
        if held == "device" or (held is None and self._fits()):
            self._hold()
        elif held == "ahead" or (held is None and runtime.device.type == "cuda"):
            windows = maker.window is not None
            self.keep_in_main_memory("a step shows windows of them" if windows else
                                     "they would take more than half of what is free on the GPU")  # fmt: skip

    def at(self, step: int) -> tuple[int, Batch]:
        """Epoch and batch of a step (from zero), on the training device."""
        if self._thread is None:
            return self._make(step)
        for wanted in range(step, step + AHEAD + 1):
            if wanted not in self._waiting:
                self._waiting[wanted] = self._thread.submit(self._make, wanted)
        epoch, batch = self._waiting.pop(step).result()
        return epoch, batch.to(self._runtime.device)

    def keep_in_main_memory(self, reason: str) -> None:
        """Give the device's memory back; from now on batches are prepared ahead in main memory."""
        self._maker = self._host
        self.held = "ahead"
        self._thread = ThreadPoolExecutor(1, "batches", self._runtime.join_thread)
        release_memory()
        self._say(f"the captures stay in main memory and batches are prepared ahead, because {reason}")

    def close(self) -> None:
        """End the background thread."""
        if self._thread is not None:
            self._thread.shutdown(cancel_futures=True)

    def _fits(self) -> bool:
        if self._runtime.device.type != "cuda" or self._host.window is not None:
            return False
        free, _ = torch.cuda.mem_get_info(self._runtime.device)
        return device_bytes(self._host) <= DEVICE_SHARE * free

    def _hold(self) -> None:
        try:
            self._maker = DeviceBatchMaker(self._host, self._runtime.device)
            self.held = "device"
            return
        except RuntimeError as error:
            if not is_out_of_memory(error):
                raise
        self.keep_in_main_memory("the GPU ran out of memory for them")

    def _make(self, step: int) -> tuple[int, Batch]:
        config, runtime = self._config, self._runtime
        epoch, indices = draw(len(self._host), config.batch * runtime.world, step, config.seed)
        mine = indices[runtime.rank * config.batch : (runtime.rank + 1) * config.batch]
        rng = np.random.default_rng((config.seed, step, 0))
        for _ in range(runtime.rank * config.batch):  # of the pictures of other processes
            rng.integers(0, self._host.feature_size**2, FREE_RAYS)
        batch = self._maker.batch(mine, rng, FREE_RAYS)
        if self.held == "device":
            return epoch, batch
        if self.held == "ahead":
            return epoch, batch.pinned() if runtime.device.type == "cuda" else batch
        return epoch, batch.to(runtime.device)
