"""Safetensors files that nobody vouches for: bounded, of a known format, one line where something is wrong."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from safetensors import SafetensorError, safe_open

from gazenerf.errors import UserError
from gazenerf.files import check_name


@dataclass(frozen=True)
class TensorFileKind:
    """What a file of some kind is.

    Attributes:
        name: For messages, such as `subject`.
        format: Value of `format` in its metadata.
        most_bytes: Whole MiB; a larger file is not opened.
        absent: End of the message where there is no such file.
        foreign: End of the message where the format is another.
        fix: End of the message where it cannot be read; may be empty.
        file: What a file of this kind is called where that is not `name`.
    """

    name: str
    format: str
    most_bytes: int
    absent: str
    foreign: str
    fix: str = ""
    file: str = ""


@contextmanager
def open_tensors(path: Path, kind: TensorFileKind, framework: str = "numpy") -> Iterator[tuple[Any, dict[str, str]]]:
    """An opened safetensors file and its metadata.

    What the block raises of the kinds that damaged content causes becomes one line.

    Args:
        path: The file.
        kind: What it should be.
        framework: Of the tensors: numpy or pt.

    Raises:
        UserError: missing, too large, damaged, or of another format.
    """
    check_name(path)
    if not path.is_file():
        raise UserError(f"no {kind.file or kind.name} at {path}; {kind.absent}")
    if path.stat().st_size > kind.most_bytes:
        raise UserError(f"{path} is larger than a {kind.name} can be ({kind.most_bytes >> 20} MiB)")
    try:
        with safe_open(path, framework=framework) as file:
            metadata = file.metadata() or {}
            if metadata.get("format") != kind.format:
                what, found = kind.file or kind.name, metadata.get("format")
                raise UserError(f"{path} is not a {what} (format {found!r}); {kind.foreign}")
            yield file, metadata
    except (SafetensorError, OSError, KeyError, ValueError, TypeError, RuntimeError, RecursionError) as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise UserError(f"cannot read the {kind.name} {path}: {reason}{kind.fix and '; '}{kind.fix}") from error
