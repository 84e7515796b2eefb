"""Measurements that are made already, in a file beside the report, so that a run that was cut short goes on."""

from __future__ import annotations

import base64
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from gazenerf.errors import UserError
from gazenerf.files import parse_json, whole_file

MAX_BYTES = 2**30

Rows = list[dict[str, Any]]
"""Name to number; vectors are `packed`."""


def packed(vector: np.ndarray) -> str:
    """A vector (D,) as text, float32."""
    return base64.b64encode(np.ascontiguousarray(vector, "<f4").tobytes()).decode()


def unpacked(text: str) -> np.ndarray:
    """(D,) float32: what `packed` packed."""
    return np.frombuffer(base64.b64decode(text), "<f4")


@dataclass
class MadeRows:
    """What was measured so far.

    Attributes:
        path: The file: a line of what was asked for, then a line for each measurement.
        asked: By what the rows were measured.
        rows: Name of a measurement to its rows.
        left_out: Measurement to why it is not made; None before anything was measured.
    """

    path: Path
    asked: dict[str, Any]
    rows: dict[str, Rows] = field(default_factory=dict)
    left_out: dict[str, str] | None = None

    @classmethod
    def beside(cls, report: Path, asked: dict[str, Any]) -> MadeRows:
        """Those of an earlier run that was asked for the same, or none."""
        made = cls(report.with_name(f"{report.name}.rows"), json.loads(json.dumps(asked)))
        if not made.path.is_file() or made.path.stat().st_size > MAX_BYTES or not made._read():
            made.rows, made.left_out = {}, None
            with whole_file(made.path) as temporary:
                temporary.write_text(json.dumps(made.asked) + "\n", encoding="utf-8")
        return made

    def _read(self) -> bool:
        """Whether the file is of the same; a last line that was cut short is left out."""
        try:
            first, *lines = self.path.read_text(encoding="utf-8").splitlines()
            if parse_json(first) != self.asked:
                return False
            for line in lines:
                said = parse_json(line)
                self._keep(str(said["name"]), list(said["rows"]), dict(said["left_out"]))
        except (OSError, ValueError, KeyError, TypeError):
            return bool(self.rows)
        return True

    def add(self, name: str, rows: Rows, left_out: dict[str, str]) -> None:
        """Keep the rows of a measurement.

        Raises:
            UserError: it was made with other instruments than those before, or the file cannot be written.
        """
        self._keep(name, rows, left_out)
        try:
            with self.path.open("a", encoding="utf-8") as file:
                file.write(json.dumps({"name": name, "rows": rows, "left_out": left_out}) + "\n")
        except OSError as error:
            raise UserError(f"cannot write {self.path}: {error.strerror or error}") from error

    def _keep(self, name: str, rows: Rows, left_out: dict[str, str]) -> None:
        if self.left_out is None:
            self.left_out = left_out
        if differing := left_out.keys() ^ self.left_out.keys():
            what = min(differing)
            why = (left_out | self.left_out)[what]
            raise UserError(f"some machines measure {what} and others cannot ({why}); set all of them up alike")
        self.rows[name] = rows
