"""Commands of this package, each in a process of its own that tells how far it is."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections import deque
from collections.abc import Sequence

from gazenerf.progress import Progress

PROGRESS = re.compile(r"progress: (.*) (\d+)/(\d+)")
"""A line of a command that says how far it is; see `gazenerf.cli.common.showing_progress`."""

KEPT_LINES = 50
"""Lines of what a command says that are remembered."""

LONGEST_TOLD = 400
"""Characters of what a failed command said that are told."""


def start_command(words: Sequence[str], own_session: bool = False) -> subprocess.Popen[bytes]:
    """Start `gazenerf` with some words; what it says on standard error is read by `follow`.

    Args:
        words: After the program's name.
        own_session: Ctrl-C in the terminal does not reach it.
    """
    return subprocess.Popen(
        [sys.executable, "-m", "gazenerf", *words],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        env=os.environ | {"PYTHONUNBUFFERED": "1", "GAZENERF_PROGRESS": "lines"},
        start_new_session=own_session,
    )


def follow(process: subprocess.Popen[bytes], progress: Progress) -> str:
    """Wait for a command to end, and tell how far it is meanwhile; the last line that it said beside that."""
    assert process.stderr is not None
    said: deque[str] = deque(maxlen=KEPT_LINES)
    for line in process.stderr:
        text = line.decode("utf-8", "replace").strip()
        if told := PROGRESS.fullmatch(text):
            progress(told[1], int(told[2]), int(told[3]))
        elif text:
            said.append(text)
    process.wait()
    return (said[-1] if said else f"it ended with code {process.returncode}")[:LONGEST_TOLD]
