"""`gazenerf`: finds the command, runs it, and turns what the user can fix into one line."""

from __future__ import annotations

import argparse
import importlib.util
import os
import re
import sys
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any, NoReturn

from gazenerf import __version__
from gazenerf.cli.option_files import FileArguments, check_target, merged, missing, read_options, save_options
from gazenerf.cli.parser import add_options, given, made, parsed
from gazenerf.cli.report import SpeechOptions, current, reporting
from gazenerf.errors import UserError
from gazenerf.names import did_you_mean
from gazenerf.options import flag_of, options_of

COMMANDS = {
    "demo": "orbit, gaze grid, meshes and check of the bundled subject in one folder",
    "orbit": "render a video that flies around a head while its eyes turn",
    "sheet": "put many gazes or views of a head into one labelled picture",
    "view": "look around a head in the browser: camera, gaze, person, layers and meshes by hand",
    "mesh": "extract face and eye meshes from the density volumes",
    "export": "write pictures with their cameras for nerfstudio and COLMAP",
    "check": "measure whether a field, or a folder of frames, is one consistent 3D head",
    "fit": "fit head model and field to photographs of a person, or of each of many, and save them as subjects",
    "redirect": "change where the person in a photograph looks, for one picture, a folder of them or a video",
    "synthesize": "render captures of synthetic people to train on",
    "prepare": "make captures of a published gaze data set to train on",
    "train": "train a field on captures",
    "train-estimator": "train an estimator of gaze and head pose on captures, for evaluate",
    "evaluate": "measure a field on views, gazes and people it has not seen",
    "experiment": "train and measure what a table of the paper compares, and write the table",
    "share": "write a field with a model card, to publish it",
    "import-checkpoint": "convert a published checkpoint without executing it",
    "subjects": "list the bundled subjects",
    "completion": "print a shell completion script",
}
"""Command to the line that `gazenerf --help` shows; `gazenerf/cli/<command>.py` holds the rest."""

INTERRUPTED = 130
BROKEN_PIPE = 141


@dataclass(frozen=True, kw_only=True)
class CommonOptions(SpeechOptions, FileArguments):
    """What every command takes."""


class Parser(argparse.ArgumentParser):
    """An argument parser whose errors are one line, with the word that was probably meant."""

    def error(self, message: str) -> NoReturn:
        """Exit with code 2."""
        if mistyped := _MISTYPED_CHOICE.search(message):
            message += did_you_mean(mistyped["word"], re.findall(r"'([^']+)'", mistyped["known"]))
        self.exit(2, f"gazenerf: error: {message} (see `{self.prog} --help`)\n")

    def parse_known_args(self, args=None, namespace=None):  # pyright: ignore[reportIncompatibleMethodOverride]
        """As its base class does; flags that a command does not know are that command's error, not the program's."""
        found, left = super().parse_known_args(args, namespace)
        if flags := [word for word in left if word.startswith("-")]:
            known = [flag for action in self._actions for flag in action.option_strings]
            self.error(f"unrecognized arguments: {' '.join(left)}{did_you_mean(flags[0].partition('=')[0], known)}")
        return found, left


_MISTYPED_CHOICE = re.compile(r"invalid choice: '(?P<word>[^']*)' \(choose from (?P<known>.*)\)$")


def load_command(name: str) -> ModuleType:
    """The module of a command: `HELP`, a dataclass `Options`, `run(options) -> int`, and perhaps `configure(parser)`.

    Raises:
        UserError: this installation lacks it.
    """
    if not is_installed(name):
        raise UserError(f"this installation has no {name} command; install gazenerf again")
    return importlib.import_module(_module(name))


def is_installed(name: str) -> bool:
    """Whether this installation has the command's module; nothing is loaded."""
    return importlib.util.find_spec(_module(name)) is not None


def _module(name: str) -> str:
    return f"gazenerf.cli.{name.replace('-', '_')}"


def build_parser(configured: Iterable[str] | None = None, relaxed: bool = False) -> argparse.ArgumentParser:
    """The parser of the whole command line.

    Args:
        configured: Commands whose modules are loaded and whose arguments are added; the others are
            only listed, which keeps `gazenerf --help` quick. All that are installed by default.
        relaxed: Nothing has to be given, since a file of options may give it.
    """
    if configured is None:
        configured = [name for name in COMMANDS if is_installed(name)]
    parser = Parser(
        prog="gazenerf",
        description="See, measure and take out the 3D inside a gaze-redirecting head field.",
        epilog="Angles are degrees: pitch up, yaw to the subject's left. Exit codes: 0 done, 1 a measured threshold "
        "or a row of an experiment failed, 2 something to fix in the input.",
    )
    parser.add_argument("--version", action="version", version=f"gazenerf {__version__}")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for name, line in COMMANDS.items():
        command = commands.add_parser(name, help=line, description=f"{line[0].upper()}{line[1:]}.")
        if name in configured:
            module = load_command(name)
            own = []
            if hasattr(module, "Options"):
                add_options(command, module.Options, relaxed=relaxed)
                own = [flag_of(field, about) for field, about in options_of(module.Options).items()]
            add_options(command, CommonOptions, but=own)
            if hasattr(module, "configure"):
                module.configure(command)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line.

    Args:
        argv: Words after the program's name; those of this process by default.

    Returns:
        The exit code: 0 done, 1 a measured threshold or a row of an experiment failed, 2 the user can fix it, 130
        interrupted.
    """
    words = list(sys.argv[1:] if argv is None else argv)
    asked = words[0] if words else ""
    warnings.showwarning = _one_line
    try:
        relaxed = any(word.partition("=")[0] == "--options" for word in words)
        parser = build_parser([asked] if asked in COMMANDS else [], relaxed)
        args = parser.parse_args(words)
        module = load_command(args.command)
        common = parsed(CommonOptions, args)
        with reporting(common) as report:
            code = _run(module, parser, args, common) if hasattr(module, "Options") else module.run(args)
            report.close(args.command, code)
        sys.stdout.flush()
        return code
    except UserError as error:
        print(f"gazenerf: error: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return BROKEN_PIPE
    except KeyboardInterrupt:
        print("gazenerf: interrupted", file=sys.stderr)
        return INTERRUPTED
    except (ImportError, OSError) as error:
        from gazenerf.cli.libraries import missing_library

        hint = missing_library(error)
        if hint is None:
            raise
        print(f"gazenerf: error: {hint}", file=sys.stderr)
        return 2


def _run(module: ModuleType, parser: argparse.ArgumentParser, args: argparse.Namespace, files: FileArguments) -> int:
    """Run a command with the options that were typed and those of a file, and save them where that is asked for.

    They are saved when the command has ended, also by Ctrl-C, but not when something in them is to be mended.
    """
    kind = module.Options
    found = given(kind, args)
    if files.options_file is not None:
        found = merged(found, read_options(files.options_file, kind, args.command), kind)
        if absent := missing(found, kind):
            raise UserError(
                f"neither {files.options_file} nor the command line gives {', '.join(absent)} "
                f"(see `{parser.prog} {args.command} --help`)"
            )
    if files.save_options is not None:
        check_target(files.save_options, bool(found.get("overwrite")))
    options = made(kind, found)
    try:
        code = module.run(options)
    except KeyboardInterrupt:
        _save(files, args.command, found)
        raise
    _save(files, args.command, found)
    return code


def _save(files: FileArguments, command: str, found: dict[str, Any]) -> None:
    if files.save_options is not None:
        save_options(files.save_options, command, found)
        current().add(written=[files.save_options])


def _one_line(message: Warning | str, *_: object, **__: object) -> None:
    current().warn(str(message))


if __name__ == "__main__":
    raise SystemExit(main())
