"""What is done to an item, wherever that is: what it needs is opened once, and kept from item to item."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack
from typing import Any, Protocol, TypeVar

from gazenerf.errors import UserError
from gazenerf.folders import Folder

Item = TypeVar("Item")
Result = TypeVar("Result")
Item_contra = TypeVar("Item_contra", contravariant=True)
Result_co = TypeVar("Result_co", covariant=True)

Tell = Callable[[], None]
"""Is told of each step of an item, and raises `Stopped` where the run is to end."""


class Job(Protocol[Item_contra, Result_co]):
    """Work of one kind: a frozen dataclass of plain values and paths, which pickle can pass between processes."""

    def opened(self) -> AbstractContextManager[Callable[[Item_contra, Tell], Result_co]]:
        """What does the work to one item; within the block files, networks and renderers are open.

        Raises:
            UserError: something that it needs is not there.
        """
        ...


def require_shared(file: Folder) -> None:
    """Refuse to write beside a file that was written before the job began, and cannot be seen from here.

    Raises:
        UserError: it cannot.
    """
    if not file.is_file():
        raise UserError(f"there is no {file} here; the folder must be one that all machines share, under one path")


class Stopped(Exception):
    """The run is to end before the item is done."""


class CannotStart(UserError):
    """A process cannot open what the job needs; the others could not either, so the run ends."""


class UnexpectedError(Exception):
    """What failed in another process, as words: errors of OpenGL hold pointers, which pickle cannot pass on."""


def reason(error: BaseException) -> str:
    """An error in words."""
    if isinstance(error, (UserError, UnexpectedError)):
        return str(error)
    return " ".join(f"{type(error).__name__}: {error}".split())


class _Open(threading.local):
    """What the calling thread has open; an OpenGL context belongs to the thread that made it."""

    job: Any = None
    work: Callable[[Any, Tell], Any] | None = None
    stack: ExitStack | None = None


_open = _Open()


def close_job() -> None:
    """Close what the last job of this thread opened."""
    stack, _open.job, _open.work, _open.stack = _open.stack, None, None, None
    if stack is not None:
        stack.close()


def do(job: Job[Item, Result], item: Item, tell: Tell) -> Result:
    """The result of one item, in a process that is there for it.

    Raises:
        CannotStart: the job cannot be opened.
        UserError: the item cannot be used.
        UnexpectedError: anything else that went wrong, as words.
        Stopped: by `tell`.
    """
    if _open.work is None or _open.job != job:
        close_job()
        stack = ExitStack()
        try:
            _open.work = stack.enter_context(job.opened())
        except Exception as error:
            where = socket.gethostname()
            raise CannotStart(f"a process on {where} cannot start ({reason(error)})") from error
        _open.job, _open.stack = job, stack
    try:
        return _open.work(item, tell)
    except (UserError, Stopped):
        raise
    except Exception as error:
        raise UnexpectedError(reason(error)) from error
