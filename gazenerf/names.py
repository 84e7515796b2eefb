"""The name that somebody probably meant."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """` (did you mean ada?)` where a known name is close to a mistyped word, nothing where none is."""
    close = difflib.get_close_matches(word.lower(), sorted(known), n=1, cutoff=0.7)
    return f" (did you mean {close[0]}?)" if close else ""
