"""Tables of numbers in text, as data sets have their annotations; lines that are damaged are told of one by one."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import numpy as np

from gazenerf.datasets.published import LARGEST_ROW
from gazenerf.errors import UserError
from gazenerf.files import LONGEST_NAME

MAX_TABLE_BYTES = 512 * 2**20
"""An annotation of ETH-XGaze has 149 numbers a picture."""

LONGEST_PATH = 1024
"""Characters of a relative path."""


@dataclass(frozen=True)
class Line:
    """One line of a table.

    Attributes:
        words: The first ones, as text.
        numbers: (K,) the rest; empty where they are not numbers.
        fault: Why it cannot be used, or None.
    """

    words: tuple[str, ...]
    numbers: np.ndarray
    fault: str | None


def read_table(path: Path, separator: str, words: int, columns: tuple[int, ...], version: str) -> list[Line]:
    """The lines of an annotation.

    Args:
        path: Text, UTF-8.
        separator: Between columns.
        words: How many columns are text, the first ones.
        columns: How many columns there may be.
        version: Ends the message where the first line has another number of columns.

    Raises:
        UserError: missing, too large, no text, or of another version.
    """
    try:
        if path.stat().st_size > MAX_TABLE_BYTES:
            raise UserError(f"{path} is larger than {MAX_TABLE_BYTES >> 20} MiB; annotations are smaller")
        text = path.read_text(encoding="utf-8-sig").splitlines()
    except FileNotFoundError as error:
        raise UserError(f"{path} does not exist; {version}") from error
    except (OSError, UnicodeDecodeError) as error:
        raise UserError(f"{path} cannot be read as text ({str(error)[:80]}); {version}") from error
    lines = [_words(line, separator) for line in text if line.strip()]
    if not lines or len(lines) >= LARGEST_ROW:
        raise UserError(f"{path} holds {len(lines)} lines; 1 to {LARGEST_ROW - 1} are read")
    if len(lines[0]) not in columns:
        wanted = " or ".join(str(count) for count in columns)
        raise UserError(f"{path} has {len(lines[0])} columns, not {wanted}; {version}")
    return [_line(line, words, len(lines[0])) for line in lines]


def _words(line: str, separator: str) -> list[str]:
    """Columns; several blanks separate two of them, but two commas hold an empty one between them."""
    return [word for word in line.split(separator) if word.strip() or separator != " "]


def _line(line: list[str], words: int, columns: int) -> Line:
    try:
        if len(line) != columns:
            raise ValueError
        return Line(tuple(line[:words]), np.array([_number(word) for word in line[words:]]), None)
    except ValueError:
        return Line(tuple(line[:words]), np.zeros(0), "its line in the annotation is cut short or damaged")


def _number(word: str) -> float:
    """A number, NaN for a word at a place that nobody reads as a number."""
    stripped = word.strip()
    return float("nan") if stripped.isalpha() and stripped not in ("nan", "inf") else float(stripped)


def inside(folder: Path, name: str) -> Path:
    """A file below a folder by a relative name.

    Raises:
        ValueError: the name leads out of the folder.
    """
    parts = PurePosixPath(name).parts
    if not parts or PurePosixPath(name).is_absolute() or ".." in parts or "\0" in name or "\\" in name:
        raise ValueError(f"it names the file {name[:60]!r}, which is not below the subject's folder")
    if max(len(os.fsencode(part)) for part in parts) > LONGEST_NAME or len(name) > LONGEST_PATH:
        raise ValueError(f"it names the file {name[:60]!r}..., which is too long a name")
    return folder.joinpath(*parts)
