"""Where many items are worked on."""

from __future__ import annotations

import re
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, TypeVar

from gazenerf.cores import usable_cores
from gazenerf.errors import UserError
from gazenerf.folders import Folder
from gazenerf.options import option

Options = TypeVar("Options")

_ADDRESS = re.compile(r"[a-z]+://\S+:\d+")


@dataclass(frozen=True)
class Where:
    """Processes of this machine, or the workers of a cluster.

    Attributes:
        workers: Processes here; with 1 the work is done in the calling thread.
        scheduler: Address of a Dask scheduler, whose workers do it instead.

    Raises:
        UserError: no processes, or no such address.
    """

    workers: int = 1
    scheduler: str | None = None

    def __post_init__(self) -> None:
        if self.workers < 1:
            raise UserError(f"--workers must be at least 1, got {self.workers}")
        if self.scheduler is not None and not _ADDRESS.fullmatch(self.scheduler):
            raise UserError(f"--scheduler {self.scheduler} is no address; write it like tcp://192.168.0.10:8786")

    def folder(self, path: Folder) -> Folder:
        """A path that means the same to a worker with another working directory; a URL does."""
        return path if self.scheduler is None or not isinstance(path, Path) else path.absolute()

    def placed(self, options: Options) -> Options:
        """Options (a dataclass) whose paths mean the same everywhere; a path that is not here may be a name."""
        if self.scheduler is None:
            return options
        found: dict[str, Any] = {field.name: getattr(options, field.name) for field in fields(options)}  # pyright: ignore[reportArgumentType]
        paths = {
            name: self.folder(value) for name, value in found.items() if isinstance(value, Path) and value.exists()
        }
        return replace(options, **paths)  # pyright: ignore[reportArgumentType, reportCallIssue]


HERE = Where()
"""One item after the other, in the calling thread."""


@dataclass(frozen=True, kw_only=True)
class ExecutionOptions:
    """Where the work is done.

    Attributes:
        workers: Processes here; as many as there are cores by default.
        scheduler: Address of a running Dask scheduler, whose workers do it instead.
    """

    workers: int | None = option(None, "processes on this machine (default: one for each core)", metavar="N")
    scheduler: str | None = option(
        None,
        "a running Dask scheduler, whose workers do it instead (docs/captures.md#on-several-machines)",
        metavar="tcp://HOST:PORT",
    )

    def where(self, default: int | None = None) -> Where:
        """The place that is meant.

        Args:
            default: Processes where nothing is said; one for each core if None.

        Raises:
            UserError: both are given, or cannot be.
        """
        if self.scheduler is not None and self.workers is not None:
            raise UserError("--workers is for processes here; how many a --scheduler has, its workers decide")
        default = usable_cores() if default is None else default
        return Where(default if self.workers is None else self.workers, self.scheduler)
