"""Training on two processes through Lightning Fabric, as on two GPUs, but on the CPU."""

from __future__ import annotations

import importlib.util
import json
import os
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from gazenerf.checkpoints import load_field
from gazenerf.data import SynthesizeOptions, synthesize
from gazenerf.errors import UserError
from gazenerf.training.run import TrainOptions, train_field
from gazenerf.training.runtime import started_by_launcher

STEPS = 5
ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def captures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("captures")
    try:
        synthesize(folder, SynthesizeOptions(people=2, views=3, size=64, seed=2))
    except UserError as error:
        pytest.skip(f"captures need off-screen OpenGL: {error}")
    return folder


def settings(batch: int) -> tuple[str, ...]:
    return f"steps={STEPS}", f"batch={batch}", "warmup=2", 'field_overrides={"feature_size": 16}'


def alone(captures: Path, out: Path, batch: int, **more: Any) -> None:
    options = TrainOptions(
        data=captures, out=out, preset="tiny", held_out=0, held_out_views=0.0, device="cpu", precision="float32",
        settings=settings(batch), **more,
    )  # fmt: skip
    train_field(options)


def started(launcher: list[str], captures: Path, out: Path, *more: str) -> subprocess.Popen[str]:
    """Training with one picture in a process, as a launcher starts it."""
    words = ["train", "--data", captures, "--out", out, "--preset", "tiny", "--held-out", "0", "--held-out-views", "0"]
    words += ["--device", "cpu", "--precision", "float32", *more, "--set", *settings(1)]
    environment = os.environ | {"OMP_NUM_THREADS": "1", "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", *launcher, *map(str, words)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment)


def printed_by(process: subprocess.Popen[str]) -> str:
    """What a process printed that ended well."""
    try:
        out, errors = process.communicate(timeout=540)
    finally:
        process.kill()
    assert process.returncode == 0, errors
    return out


def in_two(launcher: list[str], captures: Path, out: Path, *more: str) -> str:
    """Train with one picture in each of two processes; what was printed."""
    return printed_by(started(launcher, captures, out, *more))


def free_port() -> str:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return str(free.getsockname()[1])


def curve(run: Path) -> list[dict[str, float]]:
    """The parts of the loss at each step."""
    rows = [json.loads(line) for line in (run / "log.jsonl").read_text().splitlines()]
    assert [row["step"] for row in rows] == list(range(1, STEPS + 1))
    return [{name: value for name, value in row.items() if name not in ("step", "seconds", "epoch")} for row in rows]


def compare(one: Path, two: Path) -> None:
    """One process and two have the same curve."""
    for step, (wanted, found) in enumerate(zip(curve(one), curve(two), strict=True), 1):
        assert wanted.keys() == found.keys()
        assert sum(found.values()) == pytest.approx(sum(wanted.values()), rel=0.01), f"step {step}"
        for name, value in wanted.items():
            assert found[name] == pytest.approx(value, rel=0.05, abs=2e-3), f"{name} at step {step}"


@pytest.mark.skipif(importlib.util.find_spec("lightning") is None, reason="needs gazenerf[multi-gpu]")
def test_two_processes_learn_as_one_does_and_go_on_from_each_others_states(captures, tmp_path):
    one, two = tmp_path / "one", tmp_path / "two"
    alone(captures, one, batch=2)
    printed = in_two(["gazenerf"], captures, two, "--devices", "2", "--stop-after", "0")
    assert printed.count("wrote") == 1
    assert load_field(two / "field.safetensors").about["steps"] == 1
    alone(captures, two, batch=2, resume=True, stop_after=0.0)
    assert load_field(two / "field.safetensors").about["steps"] == 2
    where = ["--master-addr", "127.0.0.1", "--master-port", free_port()]
    launcher = ["torch.distributed.run", "--nproc-per-node", "2", *where]
    assert in_two([*launcher, "-m", "gazenerf"], captures, two, "--resume").count("wrote") == 1
    compare(one, two)


@pytest.mark.skipif(importlib.util.find_spec("lightning") is None, reason="needs gazenerf[multi-gpu]")
def test_fabric_run_trains_on_two_machines_that_are_one(captures, tmp_path):
    """The lines of docs/training.md, on the loopback address."""
    one, two, port = tmp_path / "one", tmp_path / "two", free_port()
    alone(captures, one, batch=2)
    script = tmp_path / "gazenerf"
    script.write_text("import sys\nfrom gazenerf.cli.main import main\nsys.exit(main())\n")
    nodes = ["--accelerator", "cpu", "--num-nodes", "2", "--main-address", "127.0.0.1", "--main-port", port]
    launcher = ["lightning.fabric.cli", "--devices", "1", *nodes, "--node-rank"]  # `fabric run`
    machines = [started([*launcher, rank, "--", str(script)], captures, two) for rank in "01"]
    try:
        assert sorted(printed_by(machine).count("wrote") for machine in machines) == [0, 1]
    finally:
        for machine in machines:
            machine.kill()
    compare(one, two)


def test_launchers_say_how_many_processes_there_are(monkeypatch):
    for name in ("TORCHELASTIC_RUN_ID", "SLURM_STEP_NUM_TASKS"):
        monkeypatch.delenv(name, raising=False)
    assert started_by_launcher(4, 2) == (4, 2)
    with pytest.raises(UserError, match="--devices and --nodes must be at least 1, got 0 and 1"):
        started_by_launcher(0, 1)
    monkeypatch.setenv("SLURM_STEP_NUM_TASKS", "8")
    assert started_by_launcher(4, 2) == (4, 2)
    with pytest.raises(UserError, match="srun started 8 processes; give --devices"):
        started_by_launcher(1, 1)
    for name, value in (("TORCHELASTIC_RUN_ID", "none"), ("LOCAL_WORLD_SIZE", "4"), ("WORLD_SIZE", "8")):
        monkeypatch.setenv(name, value)
    assert started_by_launcher(1, 1) == started_by_launcher(4, 2) == (4, 2)
    with pytest.raises(UserError, match="started 4 processes on each of 2 machines, not --devices 8 --nodes 1"):
        started_by_launcher(8, 1)
