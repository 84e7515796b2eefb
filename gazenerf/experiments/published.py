"""The paper's printed numbers, each with the table that it is of."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

FILE = Path(__file__).parent / "published.json"


@dataclass(frozen=True)
class PublishedTable:
    """A table of the paper.

    Attributes:
        table: Its number.
        label: Of it in the paper's source.
        titles: Row to the paper's name of it, by the order of the paper's rows.
        sets: Data set to row to measurement to value.
        said: What the paper says in words, where it prints no numbers.
    """

    table: str
    label: str
    titles: Mapping[str, str]
    sets: Mapping[str, Mapping[str, Mapping[str, float]]]
    said: str


@cache
def published() -> Mapping[str, PublishedTable]:
    """Experiment to the paper's table."""
    tables = json.loads(FILE.read_text(encoding="utf-8"))["tables"]
    return {name: _table(about) for name, about in tables.items()}


def _table(about: dict) -> PublishedTable:
    titles: dict[str, str] = {}
    sets = {}
    for name, found in about["sets"].items():
        titles |= {row: values[0] for row, values in found["rows"].items()}
        sets[name] = {
            row: dict(zip(found["columns"], values[1:], strict=True)) for row, values in found["rows"].items()
        }
    return PublishedTable(about["table"], about["label"], titles, sets, about.get("said", ""))
