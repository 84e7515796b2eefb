"""Items done in the calling thread and in processes, and what options say of places."""

from __future__ import annotations

import os
import signal
import threading
import time
from dataclasses import dataclass
from pathlib import Path

import pytest

from gazenerf.errors import UserError
from gazenerf.execution import ExecutionOptions, Failures, Where, results
from gazenerf.execution.job import UnexpectedError
from tests.execution.jobs import DEADLY, WRONG, Pointed, Squaring


def test_items_here_are_told_step_by_step_and_bugs_are_seen(tmp_path):
    (tmp_path / "process").touch()
    steps: list[int] = []
    found = list(results(Squaring(tmp_path), [1, WRONG, 2], Where(), size=lambda _: 3, advance=steps.append))
    assert [done.error is None for done in found] == [True, False, True] and found[2].result == 4
    assert steps == [1, 2, 3, 1, 2] and str(found[1].error) == "5 is not liked"
    with pytest.raises(UserError, match="not liked"):
        _ = found[1].result
    with pytest.raises(Pointed):
        list(results(Squaring(tmp_path), [6], Where(8)))
    assert list(results(Squaring(tmp_path), [], Where(8))) == []


def test_a_process_that_dies_costs_a_retry(tmp_path):
    def kill() -> None:
        until = time.monotonic() + 120
        while time.monotonic() < until and not (tmp_path / "process").is_file():
            time.sleep(0.02)
        os.kill(int((tmp_path / "process").read_text()), signal.SIGKILL)

    killer = threading.Thread(target=kill)
    killer.start()
    found = {done.item: done for done in results(Squaring(tmp_path), range(8), Where(2))}
    killer.join()
    assert sorted(found) == list(range(8)) and found[DEADLY].result == 9
    assert isinstance(found[6].error, UnexpectedError) and "Pointed: odd" in str(found[6].error)


def test_failures_are_one_line():
    failures = Failures("shard", "shards", "renders them")
    failures.refuse()
    assert not failures.add("b", UserError("no room")) and not failures.add("a", ValueError("x\ny"))
    with pytest.raises(
        UserError,
        match=r"^2 shards failed \(a, b\): ValueError: x y; the same command renders them, and with --workers",
    ):
        failures.refuse()
    assert [failures.add(str(i), UserError("")) for i in range(6)] == [False] * 5 + [True]


@dataclass(frozen=True)
class Folders:
    """Options with paths."""

    root: Path
    size: int
    masks: Path | None = None


def test_places(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert ExecutionOptions(workers=3).where() == Where(3) and ExecutionOptions().where(1) == Where(1)
    (tmp_path / "a").touch()
    there = ExecutionOptions(scheduler="tcp://10.0.0.1:8786").where()
    assert there.placed(Folders(Path("a"), 3, Path("portrait"))) == Folders(tmp_path / "a", 3, Path("portrait"))
    assert Where(2).placed(Folders(Path("a"), 3)) == Folders(Path("a"), 3)
    for options, line in (
        (ExecutionOptions(workers=0), "--workers must be at least 1"),
        (ExecutionOptions(scheduler="10.0.0.1"), "no address; write it like tcp://"),
        (ExecutionOptions(workers=2, scheduler="tcp://10.0.0.1:8786"), "--workers is for processes here"),
    ):
        with pytest.raises(UserError, match=line):
            options.where()
