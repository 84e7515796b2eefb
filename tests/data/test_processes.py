"""Sets made in several processes: what fails in one of them, Ctrl-C, and kills."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from gazenerf.data import CaptureSet, SynthesizeOptions, synthesis, synthesize
from gazenerf.errors import UserError
from gazenerf.execution import failures

pytestmark = pytest.mark.usefixtures("pyrender")

SETTINGS: dict[str, Any] = {"people": 2, "views": 8, "size": 32, "seed": 5}
COMMAND = ["--people", "2", "--views", "8", "--size", "32", "--seed", "5", "--workers", "2"]

MAIN = """
if __name__ == "__main__":
    import signal, sys
    from gazenerf.cli.main import main
    signal.signal(signal.SIGINT, signal.default_int_handler)
    sys.exit(main(["synthesize", *sys.argv[1:]]))
"""

SLOW = (
    """
import time
from gazenerf.data import synthesis

plan = synthesis.plan_view

def slowly(*args):
    time.sleep(0.5)
    return plan(*args)

synthesis.plan_view = slowly
"""
    + MAIN
)

FAILING_START = (
    """
from gazenerf.data import synthesis
from gazenerf.errors import UserError

def fail(options):
    raise UserError("mitsuba cannot be loaded (libGL.so.1: cannot open shared object file)")

if __name__ != "__main__":
    synthesis._open = fail
"""
    + MAIN
)

FAILING_SHARD = (
    """
from gazenerf.data import synthesis

class Pointed(Exception):
    def __init__(self, what, why):
        self.what, self.pointer = what, lambda: why

    def __str__(self):
        return self.what

render = synthesis.render_capture

def fail(renderer, model, view):
    if view.person == 0:
        raise Pointed("out of memory", "a large picture")
    return render(renderer, model, view)

synthesis.render_capture = fail
"""
    + MAIN
)


@pytest.fixture
def start(tmp_path) -> Callable[[str, Path], subprocess.Popen[str]]:
    """Runs a program of its own process group with the arguments of a set of two shards in two processes."""

    def started(program: str, out: Path) -> subprocess.Popen[str]:
        path = tmp_path / "program.py"
        path.write_text(program)
        words = [sys.executable, str(path), "--out", str(out), *COMMAND]
        root = str(Path(__file__).parents[2])
        environment = os.environ | {"PYTHONPATH": root}
        pipe = subprocess.PIPE
        return subprocess.Popen(words, stderr=pipe, stdout=pipe, text=True, env=environment, start_new_session=True)

    return started


def shards(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.glob("person-*.npz")}


def group_is_gone(group: int, seconds: float = 20) -> bool:
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.05)
    os.killpg(group, signal.SIGKILL)
    return False


def wait_for_processes(process: subprocess.Popen[str], out: Path, seconds: float) -> None:
    """Wait until the processes that render exist, which is after the manifest, and so many seconds more."""
    until = time.monotonic() + 60
    while process.poll() is None and time.monotonic() < until and not (out / "manifest.json").is_file():
        time.sleep(0.01)
    time.sleep(0.5 + seconds)
    assert process.poll() is None, "it is still at work"


def test_a_shard_that_fails_is_named_and_the_others_are_written(tmp_path, monkeypatch):
    monkeypatch.setattr(synthesis, "SHARD_VIEWS", 2)
    options = SynthesizeOptions(people=2, views=4, size=32)
    blocked = tmp_path / "person-0000-view-00002.npz"
    blocked.mkdir()
    with pytest.raises(UserError) as caught:
        synthesize(tmp_path, options, workers=2)
    said = str(caught.value)
    assert said.startswith("1 shard failed (person-0000-view-00002.npz): cannot write") and "\n" not in said
    assert len([path for path in tmp_path.glob("person-*.npz") if path.is_file()]) == 3
    assert not list(tmp_path.glob(".person-*"))
    blocked.rmdir()
    assert synthesize(tmp_path, options, workers=2) == 2
    assert len(CaptureSet(tmp_path)) == 8


def test_many_failures_end_the_run(tmp_path, monkeypatch):
    monkeypatch.setattr(synthesis, "SHARD_VIEWS", 1)
    monkeypatch.setattr(failures, "MOST", 2)
    for view in range(20):
        (tmp_path / f"person-0000-view-{view:05d}.npz").mkdir()
    with pytest.raises(UserError, match=r"^2 shards failed"):
        synthesize(tmp_path, SynthesizeOptions(people=2, views=20, size=32), workers=2)
    assert not any(path.is_file() for path in tmp_path.glob("person-0001-*")), "what comes last was not begun"


def test_an_error_that_cannot_pass_between_processes_is_still_said(start, tmp_path):
    with start(FAILING_SHARD, tmp_path / "set") as process:
        _, said = process.communicate(timeout=120)
    assert process.returncode == 2
    assert "1 shard failed (person-0000-view-00000.npz): Pointed: out of memory;" in said and "--workers 1" in said
    assert list(shards(tmp_path / "set")) == ["person-0001-view-00000.npz"]


def test_a_library_missing_in_a_process_is_one_line_with_its_package(start, tmp_path):
    with start(FAILING_START, tmp_path / "set") as process:
        _, said = process.communicate(timeout=120)
    assert process.returncode == 2
    assert said == (
        "gazenerf: error: the system library libGL is missing; on Debian or Ubuntu: apt-get install libgl1\n"
    )


@pytest.mark.parametrize("late", [0.0, 2.5])
def test_ctrl_c_ends_every_process_without_a_trace(start, late, tmp_path):
    with start(SLOW, tmp_path / "set") as process:
        wait_for_processes(process, tmp_path / "set", late)
        os.killpg(process.pid, signal.SIGINT)
        _, said = process.communicate(timeout=60)
    assert process.returncode == 130 and said.strip() == "gazenerf: interrupted"
    assert group_is_gone(process.pid)
    assert [path.name for path in (tmp_path / "set").iterdir()] == ["manifest.json"]


def test_a_killed_run_leaves_no_process_and_goes_on(start, tmp_path):
    with start(SLOW, tmp_path / "set") as process:
        wait_for_processes(process, tmp_path / "set", 2.5)
        process.kill()
    assert group_is_gone(process.pid)
    there = shards(tmp_path / "set")
    rendered = synthesize(tmp_path / "set", SynthesizeOptions(**SETTINGS), workers=2)
    assert rendered == 16 - 8 * len(there) > 0
    assert synthesize(tmp_path / "whole", SynthesizeOptions(**SETTINGS)) == 16
    assert shards(tmp_path / "set") == shards(tmp_path / "whole")


def test_processes_keep_to_one_core_and_this_one_does_not(tmp_path, monkeypatch):
    from gazenerf.execution.processes import ONE_CORE, launching

    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delenv("LP_NUM_THREADS", raising=False)
    with launching():
        assert {name: os.environ[name] for name in ONE_CORE} == dict.fromkeys(ONE_CORE, "1")
        assert signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, ())
    assert os.environ["OMP_NUM_THREADS"] == "7" and "LP_NUM_THREADS" not in os.environ
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())
