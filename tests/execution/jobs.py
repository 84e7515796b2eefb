"""Jobs that workers of a cluster import."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from gazenerf.errors import UserError
from gazenerf.execution import Tell

DEADLY, WRONG, ODD = 3, 5, 6


@dataclass(frozen=True)
class Squaring:
    """Squares numbers; the first that does `DEADLY` notes its process and waits to be killed.

    Attributes:
        folder: Of notes.
    """

    folder: Path

    @contextmanager
    def opened(self) -> Iterator[Callable[[int, Tell], int]]:
        """Nothing is needed."""
        yield self._square

    def _square(self, number: int, tell: Tell) -> int:
        note = self.folder / "process"
        if number == DEADLY and not note.exists():
            temporary = self.folder / "writing"
            temporary.write_text(str(os.getpid()))
            temporary.rename(note)
            time.sleep(300)
        if number == WRONG:
            raise UserError("5 is not liked")
        if number == ODD:
            raise Pointed("odd")
        tell()
        return number * number


class Pointed(Exception):
    """Cannot be pickled."""

    def __init__(self, what: str) -> None:
        super().__init__(what, lambda: what)
        self.what = what

    def __str__(self) -> str:
        return self.what
