"""Items that failed in a run that goes on without them."""

from __future__ import annotations

from dataclasses import dataclass, field

from gazenerf.errors import UserError
from gazenerf.execution.job import reason

MOST = 8
"""So many failures end a run: what fails is not a single item."""


@dataclass
class Failures:
    """What failed, and what to do about it.

    Attributes:
        one, many: What an item is called.
        again: What the same command does with them.
        errors: Name of an item to why it failed.
    """

    one: str
    many: str
    again: str
    errors: dict[str, Exception] = field(default_factory=dict)

    def add(self, name: str, error: Exception) -> bool:
        """Note a failure; whether there are so many that the run should end."""
        self.errors[name] = error
        return len(self.errors) >= MOST

    def refuse(self) -> None:
        """Say what failed, in the end.

        Raises:
            UserError: something did.
        """
        if not self.errors:
            return
        first = min(self.errors)
        error = self.errors[first]
        count = f"{len(self.errors)} {self.many}" if len(self.errors) > 1 else f"1 {self.one}"
        where = "" if isinstance(error, UserError) else ", and with --workers 1 shows where this one fails"
        raise UserError(
            f"{count} failed ({', '.join(sorted(self.errors))}): {reason(error)}; the same command {self.again}{where}"
        ) from error
