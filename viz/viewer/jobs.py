"""A command of this package, run beside the viewer in a process of its own."""

from __future__ import annotations

import subprocess
import threading
from collections.abc import Callable

from gazenerf.child_commands import follow, start_command
from gazenerf.progress import Progress, silent


class Jobs:
    """Runs one command at a time.

    Args:
        ended: Given the words of a command, its exit code and the last line that it said, in a thread of the job.
        progress: Told how far the command is, in a thread of the job.
    """

    def __init__(self, ended: Callable[[list[str], int, str], None], progress: Progress = silent) -> None:
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
            # Ctrl-C is the viewer's, which then ends the command
            self._process = process = start_command(words, own_session=True)
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
        last = follow(process, self._progress)
        with self._lock:
            self._process = None
        self._ended(words, process.returncode, last)
