"""A parser from an options dataclass, and its values from what was typed.

tyro makes parsers from dataclasses too, but says what is wrong in a box of several lines without a
way to change that, takes the word `None` for every optional value, and has no flag of three states.
"""

from __future__ import annotations

import argparse
import dataclasses
import types
import typing
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Any, TypeVar

from gazenerf.errors import UserError
from gazenerf.files import check_name
from gazenerf.folders import Folder, folder_of, is_url
from gazenerf.options import Option, flag_of, options_of

T = TypeVar("T")


def add_options(
    parser: argparse.ArgumentParser, kind: type, *, relaxed: bool = False, but: Collection[str] = ()
) -> None:
    """Add the options of a dataclass to a parser; what is not given leaves no trace in its namespace.

    Args:
        parser: Of a command.
        kind: The dataclass.
        relaxed: Nothing has to be given, since a file may give it.
        but: Flags that the parser has already.
    """
    hints = typing.get_type_hints(kind)
    groups: dict[str, Any] = {"": parser}
    exclusive: dict[str, Any] = {}
    for name, option in options_of(kind).items():
        place = groups.get(option.group) or groups.setdefault(option.group, parser.add_argument_group(option.group))
        if option.only_one is not None:
            place = exclusive.get(option.only_one) or exclusive.setdefault(
                option.only_one, place.add_mutually_exclusive_group()
            )
        flag = flag_of(name, option)
        if flag in but:
            continue
        if relaxed:
            option = dataclasses.replace(option, required=False)
        if not flag.startswith("-"):
            shape = _shape(hints[name], option)
            shape.pop("required", None)
            if relaxed:
                shape |= {"nargs": "*", "default": argparse.SUPPRESS} if "nargs" in shape else {"nargs": "?"}
            place.add_argument(name, help=option.help, **shape)
            continue
        place.add_argument(flag, dest=name, default=argparse.SUPPRESS, help=option.help, **_shape(hints[name], option))
        if option.off is not None:
            off, said = option.off
            place.add_argument(off, dest=name, default=argparse.SUPPRESS, action="store_false", help=said)


def _shape(hint: Any, option: Option) -> dict[str, Any]:
    """How an option of a type is typed, as keyword arguments of `add_argument`."""
    kind = _without_none(hint)
    if kind is bool:
        turned_off = option.flag is not None and option.flag.startswith("--no-")
        return {"action": "store_false" if turned_off else "store_true"}
    shape: dict[str, Any] = {"metavar": option.metavar} if option.metavar is not None else {}
    if option.required:
        shape["required"] = True
    if option.choices is not None:
        shape["choices"] = list(option.choices)
    inner, several = kind, typing.get_args(kind)
    if typing.get_origin(kind) is tuple:
        inner = several[0]
        if several[-1] is not Ellipsis:
            shape["nargs"] = len(several)
        elif typing.get_origin(inner) is tuple:
            shape |= {"nargs": len(typing.get_args(inner)), "action": "append"}
            inner = typing.get_args(inner)[0]
        else:
            shape |= {"nargs": "+", "action": "extend"}  # given twice, both count
    if typing.get_origin(inner) is typing.Literal:
        inner = type(typing.get_args(inner)[0])
    if inner is Path:
        shape["type"] = _folder if option.url else _path
    elif inner is not str:
        shape["type"] = inner
    return shape


def _path(text: str) -> Path:
    try:
        check_name(text)
    except UserError as error:
        raise argparse.ArgumentTypeError(str(error)) from error
    if is_url(text) and not text.startswith("hf://"):
        raise argparse.ArgumentTypeError(f"{text} is a URL, and a path is meant (docs/captures.md#folders-elsewhere)")
    return Path(text)


def _folder(text: str) -> Folder:
    try:
        return folder_of(text) if is_url(text) else _path(text)
    except UserError as error:
        raise argparse.ArgumentTypeError(str(error)) from error


def _without_none(hint: Any) -> Any:
    if isinstance(hint, types.UnionType) or typing.get_origin(hint) is typing.Union:
        rest = [item for item in typing.get_args(hint) if item is not type(None)]
        return rest[0] if len(rest) == 1 else str
    return hint


def given(kind: type, namespace: argparse.Namespace) -> dict[str, Any]:
    """Field name to value of what was typed, nothing else."""
    found = {}
    for name in options_of(kind):
        if (value := getattr(namespace, name, None)) is not None:
            found[name] = _tuples(value)
    return found


def parsed(kind: type[T], namespace: argparse.Namespace) -> T:
    """The dataclass with what was typed, and its own defaults elsewhere.

    A dataclass whose defaults depend on what was typed has a class method `from_given`.
    """
    return made(kind, given(kind, namespace))


def made(kind: type[T], given: Mapping[str, Any]) -> T:
    """The dataclass with what was given by field name; see `parsed`."""
    assert dataclasses.is_dataclass(kind)
    make: Callable[..., T] = getattr(kind, "from_given", kind)
    return make(**given)


def _tuples(value: Any) -> Any:
    return tuple(_tuples(item) for item in value) if isinstance(value, list) else value
