"""Files appear whole or not at all."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
import tokenize
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from gazenerf.errors import UserError
from gazenerf.folders import Folder, sent_file

LONGEST_NAME = 255
"""Bytes that a file's name may have on every common file system."""


def check_name(path: str | os.PathLike[str] | Folder) -> None:
    """Refuse a path that no file system can hold, before anything asks the system for it.

    Raises:
        UserError: it holds a NUL character, or a name in it is too long.
    """
    text = os.fspath(path) if isinstance(path, os.PathLike) else str(path)
    if "\0" in text:
        raise UserError(f"the path {text!r} holds a NUL character; choose another name")
    longest = max((len(os.fsencode(name)) for name in Path(text).parts), default=0)
    if longest > LONGEST_NAME:
        raise UserError(f"the path {text[:60]}... holds a name of {longest} bytes; {LONGEST_NAME} are possible")


def parse_json(text: str | bytes) -> Any:
    """The value that untrusted JSON describes.

    Raises:
        ValueError: it is no JSON, or too deeply nested.
    """
    try:
        return json.loads(text)
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error


def read_json(path: Folder, most_bytes: int, *, absent: str, large: str) -> Any:
    """The value in an untrusted JSON file of at most so many bytes, with or without a byte-order mark.

    Args:
        path: The file.
        most_bytes: Whole MiB; what is larger is not read.
        absent, large: Ends of the message where the file is not there, or too large.

    Raises:
        UserError: it is missing, too large, unreadable, or no JSON.
    """
    check_name(path)
    try:
        if path.stat().st_size > most_bytes:
            raise UserError(f"{path} is larger than {most_bytes >> 20} MiB; {large}")
        return parse_json(path.read_text(encoding="utf-8-sig"))
    except FileNotFoundError as error:
        raise UserError(f"{path} does not exist; {absent}") from error
    except (OSError, ValueError) as error:
        raise UserError(f"{path} cannot be read as JSON: {str(error)[:120]}") from error


def refuse_existing(paths: Iterable[str | Folder], overwrite: bool) -> None:
    """Refuse to replace output that nobody said may be replaced.

    Args:
        paths: Files, or folders that count as taken when something is in them.
        overwrite: Whether they may be replaced.

    Raises:
        UserError: one of them is taken.
    """
    paths = [Path(path) if isinstance(path, str) else path for path in paths]
    for path in paths:
        check_name(path)
    if overwrite:
        return
    for path in paths:
        if path.exists() and not (path.is_dir() and not any(path.iterdir())):
            raise UserError(f"{path} exists; add --overwrite or choose another --out")


@contextmanager
def whole_file(path: str | Folder) -> Iterator[Path]:
    """A temporary path (same suffix) that becomes `path` when the block succeeds.

    It lies beside `path`, or, of a URL (`gazenerf.folders.folder_of`), on this machine until it is sent.

    Raises:
        UserError: the folder cannot be created or written.
    """
    target = Path(path) if isinstance(path, str) else path
    check_name(target)
    if not isinstance(target, Path):
        with sent_file(target) as temporary:
            yield temporary
        return
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(suffix=target.suffix, prefix=f".{target.stem}-", dir=target.parent)
        os.close(handle)
    except OSError as error:
        raise UserError(f"cannot write {target}: {error.strerror or error}; choose a writable --out") from error
    temporary = Path(name)
    try:
        yield temporary
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o666 & ~umask)
        temporary.replace(target)
    except OSError as error:
        temporary.unlink(missing_ok=True)
        raise UserError(f"cannot write {target}: {error.strerror or error}") from error
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


@contextmanager
def whole_folder(path: str | os.PathLike[str]) -> Iterator[Path]:
    """A temporary folder whose files move into `path` when the block succeeds.

    Files of the same name are replaced; other files in `path` are left alone.

    Raises:
        UserError: the folder cannot be created or written.
    """
    target = Path(path)
    check_name(target)
    try:
        target.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(prefix=".writing-", dir=target))
    except OSError as error:
        raise UserError(f"cannot write to {target}: {error.strerror or error}; choose a writable --out") from error
    try:
        yield temporary
        for source in sorted(temporary.rglob("*")):
            if source.is_file():
                destination = target / source.relative_to(temporary)
                destination.parent.mkdir(parents=True, exist_ok=True)
                source.replace(destination)
    except OSError as error:
        raise UserError(f"cannot write to {target}: {error.strerror or error}") from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


@contextmanager
def reading_numpy() -> Iterator[None]:
    """Within it a damaged header of an .npy or .npz file is a ValueError, as other damage is.

    NumPy parses headers as Python literals and lets errors of the tokenizer through.
    """
    try:
        yield
    except (tokenize.TokenError, SyntaxError) as error:
        raise ValueError("its header is damaged") from error
