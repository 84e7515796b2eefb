"""Write docs/commands.md from the parsers: python scripts/build_command_reference.py"""

from __future__ import annotations

import argparse
from pathlib import Path

from gazenerf.cli.main import COMMANDS, build_parser
from gazenerf.cli.report import GROUP

TARGET = Path(__file__).parent.parent / "docs" / "commands.md"

INTRODUCTION = """\
# Commands

Written by `python scripts/build_command_reference.py` from the command line itself; do not edit by hand.

Angles are degrees: pitch up, yaw to the subject's left ([conventions](conventions.md)). Exit codes: 0 done,
1 a measured threshold or a row of an experiment failed, 2 something to fix in the input, said in one line. Output
appears whole or not at all.
With `GAZENERF_PROGRESS=lines` in the environment, commands print `progress: STAGE DONE/TOTAL` on standard error for the
programs that run them.

| command | |
|---|---|
"""

EVERY = f"""
## {GROUP.capitalize()}

Every command takes these too.

%s
`--options FILE` takes what `--save-options FILE.json` wrote, a TOML file, or a JSON sidecar, and counts as typed:

```toml
# gazenerf mesh --options web.toml --out DIR
for = "web"
resolution = 160
page = false        # as --no-page
```

Names are those of the flags or of Python's options, with dashes or underscores; switches are true or false, and
`--no-labels` is `labels = false`. A name that no option has is refused. What is typed beside the file wins, and where
only one of several options can be given, it takes the place of the file's.

The sidecars that `orbit`, `mesh` and `export` write and the `report.json` of `check` hold such `options` for what is
drawn, extracted or measured; the person (`--subject`), the field (`--checkpoint`) and `--out` are given beside them.
`--overwrite` is never saved. Paths are relative to where the command runs. Options are saved when the command has ended
well or was interrupted, not when something in them is to be mended.

With `--json`, standard output holds one object: `command`, `exit_code`, `written` (paths), `measured` (values by name,
null where something could not be measured), `chosen` (person, field, hash of its weights, device, precision),
`warnings`, `seconds`, `gazenerf` and `versions`. An error (exit code 2) prints none, but its line on standard error.
`gazenerf subjects --json` prints its list. `--quiet` leaves what a command is asked to print: `subjects`, `completion`
and `check --list-metrics`.
"""


def reference() -> str:
    """The text of docs/commands.md."""
    parser = build_parser()
    chosen = next(action for action in parser._actions if isinstance(action, argparse._SubParsersAction))
    lines = [f"| [`gazenerf {name}`](#gazenerf-{name}) | {line} |\n" for name, line in COMMANDS.items()]
    sections = "".join(_section(name, chosen.choices[name]) for name in COMMANDS)
    [group] = [one for one in chosen.choices["orbit"]._action_groups if one.title == GROUP]
    return INTRODUCTION + "".join(lines) + EVERY % _table(group._group_actions) + sections


def _section(name: str, parser: argparse.ArgumentParser) -> str:
    text = f"\n## gazenerf {name}\n\n{parser.description}\n\n"
    for group in parser._action_groups:
        actions = [action for action in group._group_actions if not isinstance(action, argparse._HelpAction)]
        if not actions or group.title == GROUP:
            continue
        if group.title not in ("options", "positional arguments"):
            text += f"{str(group.title).capitalize()}:\n\n"
        text += _table(actions) + "\n"
    return text.rstrip("\n") + "\n"


def _table(actions: list[argparse.Action]) -> str:
    return "| argument | |\n|---|---|\n" + "".join(f"| `{_usage(one)}` | {_about(one)} |\n" for one in actions)


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
