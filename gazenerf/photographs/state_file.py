"""How far a run is lies in a file beside its output until all is done, so that one that was cut short goes on."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch

from gazenerf.errors import UserError
from gazenerf.files import whole_file

MAX_BYTES = 512 * 2**20
AGAIN = "add --overwrite to begin anew"


class StateFile:
    """The state of one learning, of one input and one set of options.

    Args:
        out: The output; the file lies beside it and is named after it.
        overwrite: Begin anew.

    Attributes:
        path: The file.
        there: Whether an earlier run began.
    """

    def __init__(self, out: Path, overwrite: bool = False) -> None:
        self.path = out.with_name(f"{out.stem}.state.pt")
        self.there = self.path.exists() and not overwrite
        self.asked = ""

    def expect(self, asked: Mapping[str, Any]) -> None:
        """Say what the results depend on, JSON-able.

        Raises:
            UserError: what is there is of another input or of other options, or damaged.
        """
        self.asked = json.dumps(asked, sort_keys=True)
        if self.there and self._read()["asked"] != self.asked:
            raise UserError(
                f"{self.path} has what was learned from other photographs or with other options; {AGAIN}, or choose "
                "another --out"
            )

    def begin(self) -> None:
        """From here on the file is there, with nothing learned where it was not."""
        if not self.there:
            self.keep(None)

    def keep(self, state: Mapping[str, Any] | None) -> None:
        """Write tensors and plain values in dictionaries and lists, whole or not at all."""
        with whole_file(self.path) as temporary:
            torch.save({"asked": self.asked, "state": state}, temporary)

    def kept(self) -> dict[str, Any] | None:
        """What was kept; None where nothing was learned yet.

        Raises:
            UserError: damaged.
        """
        return self._read()["state"] if self.path.exists() else None

    def damaged(self, reason: object) -> UserError:
        """What to raise where its content is of no use."""
        return UserError(f"cannot go on from {self.path} ({' '.join(str(reason).split())[:120]}); {AGAIN}")

    def _read(self) -> dict[str, Any]:
        if self.path.stat().st_size > MAX_BYTES:
            raise self.damaged(f"it is larger than {MAX_BYTES >> 20} MiB")
        try:
            found = torch.load(self.path, map_location="cpu", weights_only=True)
            return {"asked": found["asked"], "state": found["state"]}
        except Exception as error:
            raise self.damaged(error) from error

    def delete(self) -> None:
        """Remove it."""
        self.path.unlink(missing_ok=True)
