"""A command of this package, run beside the viewer in a process of its own."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Callable

from gazenerf.progress import Progress, silent

PROGRESS = re.compile(r"progress: (.*) (\d+)/(\d+)")
"""A line of a command that says how far it is; see `gazenerf.cli.common.showing_progress`."""

KEPT_LINES = 50
"""Lines of what a command says that are remembered."""

LONGEST_TOLD = 400
"""Characters of what a failed command said that the page shows."""


class Jobs:
    """Runs one command at a time.

    Args:
        ended: Given the words of a command and what went wrong, empty where it went well, in a thread of the job.
        progress: Told how far the command is, in a thread of the job.
    """

    def __init__(self, ended: Callable[[list[str], str], None], progress: Progress = silent) -> None:
        self._ended, self._progress = ended, progress
        self._lock = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None

    @property
    def busy(self) -> bool:
        """Whether a command runs."""
        return self._process is not None

    def start(self, words: list[str]) -> bool:
        """Run `gazenerf` with some words; False where another command runs already."""
        with self._lock:
            if self._process is not None:
                return False
            self._process = process = subprocess.Popen(
                [sys.executable, "-m", "gazenerf", *words],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                env=os.environ | {"PYTHONUNBUFFERED": "1", "GAZENERF_PROGRESS": "lines"},
                start_new_session=True,  # Ctrl-C is the viewer's, which then ends the command
            )
        threading.Thread(target=self._wait, args=(process, words), name="viewer-job", daemon=True).start()
        return True

    def close(self) -> None:
        """End the command that runs, if any."""
        with self._lock:
            process = self._process
        if process is not None:
            process.terminate()
            process.wait()

    def _wait(self, process: subprocess.Popen[bytes], words: list[str]) -> None:
        assert process.stderr is not None
        said = deque(maxlen=KEPT_LINES)
        for line in process.stderr:
            text = line.decode("utf-8", "replace").strip()
            if told := PROGRESS.fullmatch(text):
                self._progress(told[1], int(told[2]), int(told[3]))
            elif text:
                said.append(text)
        process.wait()
        with self._lock:
            self._process = None
        failed = process.returncode not in (0, 1)  # 1: a check's threshold failed; its report is there
        last = said[-1] if said else f"it ended with code {process.returncode}"
        self._ended(words, last[:LONGEST_TOLD] if failed else "")
