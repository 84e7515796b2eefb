"""Commands that are done once, and what is known of them."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from gazenerf.errors import UserError
from gazenerf.experiments.tasks import Task, check, do, in_a_process, machine, read_record
from gazenerf.progress import silent


@pytest.fixture
def task(tmp_path: Path) -> Task:
    return Task("thing", ("make", "it"), tmp_path / "made", tmp_path / "record.json", {"steps": 2, "of": {"a": [1]}})


def test_it_is_done_once(task: Task):
    ran = []

    def run(words, progress) -> str:
        ran.append(tuple(words))
        task.made.write_text("made")
        progress("working", 1, 2)
        return ""

    told = []
    assert do(task, run, lambda *step: told.append(step)) == "" and check(task)
    assert do(task, run, silent) == "" and ran == [("make", "it")] and told == [("thing: working", 1, 2)]
    record = read_record(task)
    assert record["finished"] and record["machines"] == [machine()] and record["command"][0] == "gazenerf"
    task.made.unlink()
    assert not check(task), "what it made is gone"


def test_one_that_failed_or_was_stopped_goes_on(task: Task):
    assert do(task, lambda *_: "no luck", silent) == "no luck" and not check(task)
    assert read_record(task)["failed"] == "no luck"

    def interrupted(words, progress) -> str:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        do(task, interrupted, silent)
    assert read_record(task)["failed"] == "interrupted"
    again = replace(task, going_on=lambda: ("go", "on"))
    seen = []
    do(again, lambda words, _: seen.append(words) or "", silent)
    assert seen == [("go", "on")] and len(read_record(task)["machines"]) == 1


def test_other_settings_are_refused_in_one_line_where_it_took_long(task: Task):
    do(task, lambda *_: task.made.write_text("made") and "", silent)
    other = replace(task, settings={"steps": 3, "of": {"a": [1]}})
    with pytest.raises(UserError, match=r"thing with other settings \(steps 2, not 3\); give the same"):
        check(other)
    cheap = replace(other, kept=False)
    assert not check(cheap)
    do(cheap, lambda *_: "", silent)
    assert read_record(task)["settings"]["steps"] == 3


def test_what_is_quickly_made_is_made_anew_where_its_source_is(task: Task, tmp_path: Path):
    do(task, lambda *_: task.made.write_text("made") and "", silent)
    measured = Task("report", ("measure",), tmp_path / "report", tmp_path / "r.json", {}, after=(task,), kept=False)
    do(measured, lambda *_: measured.made.write_text("report") and "", silent)
    os.utime(measured.made, (1e9, 1e9))
    assert not check(measured) and check(replace(measured, kept=True))


def test_a_process_says_why_it_failed(tmp_path: Path):
    why = in_a_process(["train", "--data", str(tmp_path / "none"), "--out", str(tmp_path / "out")], silent)
    assert why.startswith("no captures in") and "gazenerf: error" not in why


def test_a_command_ends_with_its_experiment(tmp_path: Path):
    """Where the experiment is interrupted, what it runs ends, too."""
    script = tmp_path / "experiment.py"
    script.write_text(
        "import signal, subprocess, sys\nfrom gazenerf.experiments import tasks\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"  # ignored where the tests run in the background
        "def start(words):\n"
        "    made = subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(60)'], stderr=subprocess.PIPE,\n"
        "                            start_new_session=True)\n"
        "    print(made.pid, flush=True)\n    return made\n"
        "tasks.start_command = start\ntasks.in_a_process(['x'], lambda *_: None)\n"
    )
    process = subprocess.Popen([sys.executable, script], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    assert process.stdout is not None
    child = int(process.stdout.readline())
    time.sleep(0.3)
    process.send_signal(signal.SIGINT)
    process.wait(30)
    with pytest.raises(ProcessLookupError):
        os.kill(child, 0)
