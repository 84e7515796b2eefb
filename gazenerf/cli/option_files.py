"""Options of a command in a file: saved as they were given, and given again.

A file is JSON or TOML: names and values of options, on their own or under `options`, as `--save-options` and the JSON
sidecars of orbits, meshes and datasets hold them, or under `options` of `about`, as reports of checks do.
"""

from __future__ import annotations

import argparse
import json
import tomllib
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any, NoReturn

from gazenerf import __version__
from gazenerf.cli.parser import add_options, given
from gazenerf.errors import UserError
from gazenerf.files import read_json, refuse_existing, whole_file
from gazenerf.names import did_you_mean
from gazenerf.options import flag_of, option, options_of, plain

GROUP = "any command"

MAX_BYTES = 64 * 2**20
"""Sidecars of long orbits hold a camera for every frame."""

NOT_SAVED = ("overwrite",)
"""Leave to replace files is given anew each time."""


@dataclass(frozen=True, kw_only=True)
class FileArguments:
    """Where options come from and go to.

    Attributes:
        options_file: Read; what is typed wins.
        save_options: Written.
    """

    options_file: Path | None = option(
        None,
        "take options from a file that --save-options wrote, from TOML, or from a JSON sidecar; what is typed wins",
        flag="--options",
        metavar="FILE",
        group=GROUP,
    )
    save_options: Path | None = option(
        None, "save the options that were given, for --options", metavar="FILE.json", group=GROUP
    )


def read_options(path: Path, kind: type, command: str) -> dict[str, Any]:
    """Field name to value of the options in a file.

    Args:
        path: JSON or TOML, the latter by its name.
        kind: The dataclass of the command's options.
        command: Its name.

    Raises:
        UserError: the file cannot be read, is of another command, or holds what is no option of it.
    """
    assert is_dataclass(kind)
    content = _content(path)
    theirs, about = content.get("command"), content.get("about")
    table = content.get("options", about.get("options", content) if isinstance(about, dict) else content)
    if not isinstance(table, dict):
        raise UserError(f"{path}: `options` is no table of names and values")
    if table is content:
        table = {name: value for name, value in content.items() if name != "command"}
    if isinstance(theirs, str) and theirs != command:
        raise UserError(f"{path} holds options of `gazenerf {theirs}`, not of `gazenerf {command}`")
    found: dict[str, Any] = {}
    for key, value in table.items():
        name = _field_of(key, kind)
        if name is None and key in {one.name for one in fields(kind)}:
            continue  # a setting of Python's alone, which reports hold too
        if name is None:
            known = [name.replace("_", "-") for name in options_of(kind)]
            meant = did_you_mean(str(key).replace("_", "-"), known)
            raise UserError(f"{path}: `gazenerf {command}` has no option {str(key)[:60]!r}{meant}")
        if name in found:
            raise UserError(f"{path}: {key!r} is given twice")
        if value is not None:
            found |= {name: _value(path, str(key), value, name, kind)}
    return _without_excluded(path, found, kind)


def merged(typed: Mapping[str, Any], filed: Mapping[str, Any], kind: type) -> dict[str, Any]:
    """What was typed, and from a file what does not exclude it."""
    about = options_of(kind)
    groups = {about[name].only_one for name in typed} - {None}
    return {name: value for name, value in filed.items() if about[name].only_one not in groups} | dict(typed)


def missing(found: Mapping[str, Any], kind: type) -> list[str]:
    """The flags of options that have to be given and are not."""
    return [flag_of(name, about) for name, about in options_of(kind).items() if about.required and name not in found]


def check_target(path: Path, overwrite: bool) -> None:
    """Refuse a file that options cannot be saved to.

    Raises:
        UserError: it is there already, or is not called .json.
    """
    if path.suffix.lower() != ".json":
        raise UserError(f"--save-options {path}: options are saved as JSON; give the file a name that ends in .json")
    refuse_existing([path], overwrite)


def save_options(path: Path, command: str, found: Mapping[str, Any]) -> None:
    """Write what was given.

    Raises:
        UserError: the file cannot be written.
    """
    options = {name: plain(value) for name, value in found.items() if name not in NOT_SAVED}
    content = {"command": command, "gazenerf": __version__, "options": options}
    with whole_file(path) as temporary:
        temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def _content(path: Path) -> dict[str, Any]:
    if path.suffix.lower() == ".toml":
        content = _toml(path)
    else:
        content = read_json(path, MAX_BYTES, absent="name a file of options", large="it holds no options")
    if not isinstance(content, dict):
        raise UserError(f"{path} holds no names and values of options")
    return content


def _toml(path: Path) -> Any:
    try:
        if path.stat().st_size > MAX_BYTES:
            raise UserError(f"{path} is larger than {MAX_BYTES >> 20} MiB; it holds no options")
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except FileNotFoundError as error:
        raise UserError(f"{path} does not exist; name a file of options") from error
    except (OSError, ValueError, RecursionError) as error:
        raise UserError(f"{path} cannot be read as TOML: {str(error)[:120]}") from error


def _field_of(key: object, kind: type) -> str | None:
    """The field that a key of a file names: its own name, with dashes or underscores, or its flag's."""
    name = str(key).replace("-", "_")
    about = options_of(kind)
    if name in about:
        return name
    for field, one in about.items():
        turned_off = one.flag is not None and one.flag.startswith("--no-")
        if one.flag is not None and not turned_off and one.flag.lstrip("-").replace("-", "_") == name:
            return field
    return None


class _Refusing(argparse.ArgumentParser):
    """A parser of one value of a file."""

    def error(self, message: str) -> NoReturn:
        raise UserError(message)


def _value(path: Path, key: str, value: Any, name: str, kind: type) -> Any:
    """A value of a file as the command takes it, checked as what is typed is."""
    about = options_of(kind)[name]
    if _is_switch(name, kind):
        if not isinstance(value, bool):
            raise UserError(f"{path}: {key} is true or false, got {str(value)[:60]!r}")
        return value
    if value == []:
        return ()
    rows = value if isinstance(value, list) and isinstance(value[0], list) else [value]
    parser = _Refusing(add_help=False, allow_abbrev=False)
    add_options(parser, kind, relaxed=True)
    try:
        typed = [word for row in rows for word in _typed(key, row, flag_of(name, about))]
        return given(kind, parser.parse_args(typed))[name]
    except UserError as error:
        raise UserError(f"{path}: {error}") from error


def _typed(key: str, row: Any, flag: str) -> list[str]:
    """What would be typed for a value."""
    several = row if isinstance(row, list) else [row]
    if any(isinstance(item, (bool, list, dict)) or item is None for item in several):
        raise UserError(f"{key} takes numbers or text, got {str(row)[:60]!r}")
    words = [str(item) for item in several]
    if not flag.startswith("-"):
        return words
    return [f"{flag}={words[0]}"] if len(words) == 1 else [flag, *words]


def _is_switch(name: str, kind: type) -> bool:
    assert is_dataclass(kind)
    [field] = [one for one in fields(kind) if one.name == name]
    return field.type in ("bool", bool) or (isinstance(field.type, str) and field.type.startswith("bool |"))


def _without_excluded(path: Path, found: dict[str, Any], kind: type) -> dict[str, Any]:
    """The options but those that say nothing of a group of which one can be given, which sidecars hold too."""
    assert is_dataclass(kind)
    about = options_of(kind)
    unchanged = {one.name for one in fields(kind) if one.default is not MISSING and found.get(one.name) == one.default}
    kept = {name: value for name, value in found.items() if about[name].only_one is None or name not in unchanged}
    groups: dict[str, str] = {}
    for name in kept:
        if (group := about[name].only_one) is not None and (other := groups.setdefault(group, name)) != name:
            first, second = (flag_of(one, about[one]) for one in (other, name))
            raise UserError(f"{path}: {second} is not allowed with {first}")
    return kept
