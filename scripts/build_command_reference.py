"""Write docs/commands.md from the parsers: python scripts/build_command_reference.py"""

from __future__ import annotations

import argparse
from pathlib import Path

from gazenerf.cli.main import COMMANDS, build_parser

TARGET = Path(__file__).parent.parent / "docs" / "commands.md"

INTRODUCTION = """\
# Commands

Written by `python scripts/build_command_reference.py` from the command line itself; do not edit by hand.

Angles are degrees: pitch up, yaw to the subject's left ([conventions](conventions.md)). Exit codes: 0 done,
1 a measured threshold failed, 2 something to fix in the input, said in one line. Output appears whole or not at all.
With `GAZENERF_PROGRESS=lines` in the environment, commands print `progress: STAGE DONE/TOTAL` on standard error for the
programs that run them.

| command | |
|---|---|
"""


def reference() -> str:
    """The text of docs/commands.md."""
    parser = build_parser()
    chosen = next(action for action in parser._actions if isinstance(action, argparse._SubParsersAction))
    lines = [f"| [`gazenerf {name}`](#gazenerf-{name}) | {line} |\n" for name, line in COMMANDS.items()]
    return INTRODUCTION + "".join(lines) + "".join(_section(name, chosen.choices[name]) for name in COMMANDS)


def _section(name: str, parser: argparse.ArgumentParser) -> str:
    text = f"\n## gazenerf {name}\n\n{parser.description}\n\n"
    for group in parser._action_groups:
        actions = [action for action in group._group_actions if not isinstance(action, argparse._HelpAction)]
        if not actions:
            continue
        if group.title not in ("options", "positional arguments"):
            text += f"{str(group.title).capitalize()}:\n\n"
        text += "| argument | |\n|---|---|\n"
        text += "".join(f"| `{_usage(action)}` | {_about(action)} |\n" for action in actions) + "\n"
    return text.rstrip("\n") + "\n"


def _usage(action: argparse.Action) -> str:
    words = argparse.HelpFormatter("gazenerf")._format_args(action, _metavar(action)) if action.nargs != 0 else ""
    name = action.option_strings[-1] if action.option_strings else ""
    return f"{name} {words}".strip().replace("|", "\\|")


def _metavar(action: argparse.Action) -> str:
    return "{" + ",".join(map(str, action.choices)) + "}" if action.choices else action.dest.upper()


def _about(action: argparse.Action) -> str:
    text = (action.help or "").replace("%%", "%").replace("|", "\\|")
    return f"**required**; {text}".rstrip("; ") if action.required and action.option_strings else text


if __name__ == "__main__":
    TARGET.write_text(reference(), encoding="utf-8")
    print(f"wrote {TARGET}")
