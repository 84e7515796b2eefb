"""Settings as frozen dataclasses from which the command line, its help and the tables in the docs are made.

A field is declared by `option`, which says what a user is told about it. How it is typed follows from
the field's type: `tuple[str, ...]` takes several words, `tuple[float, float]` two numbers,
`tuple[tuple[float, float], ...]` two numbers each time the flag is given, `bool` none.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, dataclass
from pathlib import Path
from typing import Any

from gazenerf.folders import is_remote

KEY = "option"


@dataclass(frozen=True)
class Option:
    """What a user is told about a setting.

    Attributes:
        help: One phrase; `%(default)s` is not filled in, say the default where it matters.
        flag: Its name on the command line, `--` and all; the field's name by default.
        off: A second flag that turns a `bool` off, and its help.
        metavar: What stands for the value in the help.
        group: Heading of the help under which it stands; empty for the first one.
        choices: The values that can be given; all by default.
        only_one: Options of the same name here exclude each other.
        required: Must be given on the command line.
        url: A folder that can also be given as a URL; see `gazenerf.folders`.
    """

    help: str
    flag: str | None = None
    off: tuple[str, str] | None = None
    metavar: str | tuple[str, ...] | None = None
    group: str = ""
    choices: Sequence[str | int] | None = None
    only_one: str | None = None
    required: bool = False
    url: bool = False


def option(
    default: Any = MISSING,
    help: str = "",
    *,
    factory: Callable[[], Any] | None = None,
    flag: str | None = None,
    off: tuple[str, str] | None = None,
    metavar: str | tuple[str, ...] | None = None,
    group: str = "",
    choices: Sequence[str | int] | None = None,
    only_one: str | None = None,
    url: bool = False,
) -> Any:
    """A dataclass field that is an option; see `Option`. Without a default it has to be given."""
    about = Option(help, flag, off, metavar, group, choices, only_one, default is MISSING and factory is None, url)
    if factory is not None:
        return dataclasses.field(default_factory=factory, metadata={KEY: about})
    return dataclasses.field(default=default, metadata={KEY: about})


def options_of(kind: type) -> dict[str, Option]:
    """Field name to what a user is told, of a dataclass whose fields were declared by `option`."""
    return {field.name: field.metadata[KEY] for field in dataclasses.fields(kind) if KEY in field.metadata}


def flag_of(name: str, option: Option) -> str:
    """The flag of a field; without dashes where it is given by its place."""
    return option.flag or f"--{name.replace('_', '-')}"


def words(options: Any) -> list[str]:
    """What a user would type after the command's name to get these options; defaults are left out."""
    found: list[str] = []
    for field in dataclasses.fields(options):
        about: Option | None = field.metadata.get(KEY)
        value = getattr(options, field.name)
        default = field.default if field.default_factory is dataclasses.MISSING else field.default_factory()
        if about is None or value == default:
            continue
        flag = flag_of(field.name, about)
        if isinstance(value, bool):
            found.append(about.off[0] if about.off is not None and not value else flag)
        elif isinstance(value, tuple) and value and isinstance(value[0], tuple):
            for item in value:
                found += [flag, *(f"{part:g}" if isinstance(part, float) else str(part) for part in item)]
        else:
            several = value if isinstance(value, tuple) else (value,)
            found += [flag] if flag.startswith("-") else []
            found += [f"{part:g}" if isinstance(part, float) else str(part) for part in several]
    return found


def to_dict(options: object, kind: type | None = None) -> dict[str, Any]:
    """The values of an options dataclass as JSON holds them.

    Args:
        options: The options.
        kind: A class that they inherit from, for its fields alone.
    """
    fields = dataclasses.fields(kind or options)  # type: ignore[arg-type]
    return {field.name: plain(getattr(options, field.name)) for field in fields}


def plain(value: Any) -> Any:
    """A value of an option as JSON holds it: paths as text, tuples as lists, NaN and infinity as text."""
    if isinstance(value, Path) or is_remote(value):
        return str(value)
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, (tuple, list)):
        return [plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return value
