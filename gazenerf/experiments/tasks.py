"""Commands that an experiment runs, each once: what one made is used again, and one that was stopped goes on.

Each command runs in a process of its own, so that its memory is given back, and one that dies, perhaps for want of
memory, costs its own row alone. Beside what it makes lies a record with the settings that it was made with.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
import signal
import subprocess
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from gazenerf.child_commands import follow, start_command
from gazenerf.cores import processor_name, usable_cores
from gazenerf.errors import UserError
from gazenerf.files import read_json, whole_file
from gazenerf.progress import Progress

MAX_RECORD_BYTES = 2**20
PATIENCE = 30.0
"""Seconds that a command has to end after it is told to."""


@dataclass(frozen=True)
class Task:
    """A command, and what it makes.

    Attributes:
        name: What people call it.
        words: What is typed after `gazenerf`.
        made: The file that it makes.
        record: Where the settings are kept that it was made with.
        settings: What decides what is made, as JSON has it.
        after: Tasks whose files it reads.
        kept: What was made with other settings is refused rather than made anew: it took long.
        going_on: Given nothing, the words to go on with where a run was stopped; None where the command sees to it.
    """

    name: str
    words: tuple[str, ...]
    made: Path
    record: Path
    settings: dict[str, Any]
    after: tuple[Task, ...] = ()
    kept: bool = True
    going_on: Callable[[], tuple[str, ...]] | None = field(default=None, compare=False)

    @property
    def digest(self) -> str:
        """SHA-256 of the settings, 16 digits."""
        return hashlib.sha256(json.dumps(self.settings, sort_keys=True).encode()).hexdigest()[:16]


Run = Callable[[Sequence[str], Progress], str]
"""Runs `gazenerf` with some words; the reason why it failed, empty where it did not."""


def in_a_process(words: Sequence[str], progress: Progress) -> str:
    """Run a command in a process, which ends when this one is interrupted."""
    process = start_command(words)
    try:
        last = follow(process, progress)
    except BaseException:
        _end(process)
        raise
    if process.returncode == 128 + signal.SIGINT:
        raise KeyboardInterrupt
    return "" if process.returncode == 0 else last.removeprefix("gazenerf: error: ")


def _end(process: subprocess.Popen[bytes]) -> None:
    if process.poll() is None:
        process.send_signal(signal.SIGINT)
        try:
            process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def check(task: Task) -> bool:
    """Whether a task is done.

    Raises:
        UserError: what is there was made with other settings, and took long.
    """
    record = read_record(task)
    if record.get("settings") == task.settings:
        return bool(record.get("finished")) and task.made.is_file() and not _is_behind(task)
    if record and task.kept:
        raise UserError(
            f"{task.record.parent} holds {task.name} with other settings ({_differences(record, task)}); give the same "
            "ones, or another --out"
        )
    return False


def _is_behind(task: Task) -> bool:
    """Whether what is quickly made anew is older than what it was made of, such as a model that was trained again."""
    made = task.made.stat().st_mtime
    return not task.kept and any(one.made.is_file() and one.made.stat().st_mtime > made for one in task.after)


def _differences(record: dict[str, Any], task: Task) -> str:
    """Which settings differ, in a few words."""
    before, now = _flat(record.get("settings")), _flat(task.settings)
    names = [name for name in now | before if before.get(name) != now.get(name)]
    told = [f"{name} {_word(before.get(name))}, not {_word(now.get(name))}" for name in names[:3]]
    return "; ".join([*told, *(["and others"] if len(names) > 3 else [])])


def _flat(settings: Any) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, value in settings.items() if isinstance(settings, dict) else ():
        found |= _flat(value) if isinstance(value, dict) else {str(name): value}
    return found


def _word(value: Any) -> str:
    return str(value)[:40]


def read_record(task: Task) -> dict[str, Any]:
    """What is known of the runs of a task; empty where there was none.

    Raises:
        UserError: the file is damaged.
    """
    if not task.record.is_file():
        return {}
    fix = "delete the folder that it is in, and run again"
    record = read_json(task.record, MAX_RECORD_BYTES, absent=fix, large=fix)
    if not isinstance(record, dict):
        raise UserError(f"{task.record} is damaged; {fix}")
    return record


def do(task: Task, run: Run, progress: Progress) -> str:
    """Do a task that is not done; the reason why it failed, empty where it did not."""
    if check(task):
        return ""
    record = read_record(task)
    if record.get("settings") != task.settings:
        record = {"command": ["gazenerf", *task.words], "settings": task.settings, "machines": [], "seconds": 0.0}
    words = task.words if task.going_on is None else task.going_on()
    if (here := machine()) not in record["machines"]:
        record["machines"].append(here)
    before, began = float(record["seconds"]), time.monotonic()
    _write(task, record | {"finished": False})
    why = "interrupted"
    try:
        why = run(words, lambda stage, done, total: progress(f"{task.name}: {stage}", done, total))
    finally:
        seconds = round(before + time.monotonic() - began, 1)
        _write(task, record | {"finished": not why, "failed": why, "seconds": seconds})
    return why


def _write(task: Task, record: dict[str, Any]) -> None:
    with whole_file(task.record) as temporary:
        temporary.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")


def machine() -> dict[str, Any]:
    """Where this runs: `cpu`, `cores` that may be used, `threads` that OpenMP is told to use, `gpu`."""
    import torch

    gpu = torch.cuda.get_device_name() if torch.cuda.is_available() else None
    return {
        "cpu": processor_name() or platform.machine(),
        "cores": usable_cores(),
        "threads": os.environ.get("OMP_NUM_THREADS"),
        "gpu": gpu,
    }
