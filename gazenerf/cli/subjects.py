"""`gazenerf subjects`: the heads that ship with the field."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from typing import Any

from gazenerf.cli.report import shown
from gazenerf.options import option

HELP = "list the bundled subjects"


@dataclass(frozen=True, kw_only=True)
class Options:
    """What the command takes.

    Attributes:
        json: Print JSON.
    """

    json: bool = option(False, "print JSON instead of a table")


def run(options: Options) -> int:
    """Print every bundled subject: whether training saw it, its code sizes and where it came from."""
    rows = describe_subjects()
    with shown():
        return _print(rows, options.json)


def _print(rows: list[dict[str, Any]], as_json: bool) -> int:
    if as_json:
        json.dump(rows, sys.stdout, indent=2)
        print()
        return 0
    from rich.console import Console
    from rich.table import Table

    table = Table(title="bundled subjects", title_justify="left")
    for heading in ("name", "training", "identity, expression, texture, illumination", "provenance"):
        table.add_column(heading, overflow="fold")
    for row in rows:
        about = ", ".join(f"{key} {value}" for key, value in row["provenance"].items())
        table.add_row(row["name"], row["training"], ", ".join(map(str, row["code_sizes"])), about)
    Console(markup=False, highlight=False).print(table)
    return 0


def describe_subjects() -> list[dict[str, Any]]:
    """Name, file, `training` (seen, held out or unknown), code sizes and provenance of the bundled subjects.

    Raises:
        UserError: a bundled file is damaged.
    """
    from gazenerf.subjects import bundled_subjects, load_subject

    rows = []
    for name, path in bundled_subjects().items():
        subject = load_subject(name)
        provenance = dict(subject.provenance)
        seen = provenance.pop("trained", None)
        rows.append(
            {
                "name": name,
                "file": str(path),
                "training": {True: "seen", False: "held out"}.get(seen, "unknown"),
                "code_sizes": list(subject.codes.sizes),
                "provenance": provenance,
            }
        )
    return rows
