"""A Dask scheduler and two workers on the loopback address, some of which are killed."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import pytest

from gazenerf.data import SynthesizeOptions, synthesis, synthesize
from gazenerf.data.rasterizer import Rasterizer
from gazenerf.errors import UserError
from gazenerf.execution import Where, cluster, results
from tests.execution.jobs import DEADLY, ODD, WRONG, Squaring

pytest.importorskip("distributed", reason="needs gazenerf[cluster]")

ROOT = Path(__file__).parents[2]
PATIENCE_S = 120


@dataclass
class Running:
    """Processes of a cluster."""

    address: str
    scheduler: subprocess.Popen[bytes]
    workers: list[subprocess.Popen[bytes]]


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Running]:
    folder = tmp_path_factory.mktemp("cluster")
    started: list[subprocess.Popen[bytes]] = []
    file = ["--scheduler-file", str(folder / "scheduler.json")]

    def start(kind: str, *words: str) -> subprocess.Popen[bytes]:
        log = (folder / f"{len(started)}.log").open("wb")
        command = [sys.executable, "-m", "dask", kind, *file, "--no-dashboard", *words]
        environment = os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
        started.append(subprocess.Popen(command, cwd=folder, stdout=log, stderr=log, env=environment))
        return started[-1]

    try:
        scheduler = start("scheduler", "--host", "127.0.0.1", "--port", "0")
        words = ["--nthreads", "1", "--no-nanny", "--local-directory", str(folder)]
        workers = [start("worker", *words) for _ in range(2)]  # a worker waits for the scheduler's file
        until = time.monotonic() + PATIENCE_S
        while (address := address_in(folder / "scheduler.json")) is None:
            assert scheduler.poll() is None and time.monotonic() < until, (folder / "0.log").read_text()
            time.sleep(0.05)
        yield Running(address, scheduler, workers)
    finally:
        for process in started:
            process.kill()
            process.wait()


def address_in(file: Path) -> str | None:
    """Where a scheduler says it listens; none before it has written its file, which it makes empty first."""
    try:
        return json.loads(file.read_text())["address"]
    except (FileNotFoundError, json.JSONDecodeError):
        return None


def kill_noted(folder: Path) -> None:
    """Kill the process that notes itself in a folder, as soon as it does."""
    wait_for(folder / "process")
    os.kill(int((folder / "process").read_text()), signal.SIGKILL)


def test_a_killed_worker_costs_a_retry_and_failures_are_told(running, tmp_path):
    killer = threading.Thread(target=kill_noted, args=[tmp_path])
    killer.start()
    steps: list[int] = []
    found = {
        done.item: done
        for done in results(Squaring(tmp_path), range(12), Where(scheduler=running.address), advance=steps.append)
    }
    killer.join()
    assert (tmp_path / "process").is_file() and sum(worker.poll() is not None for worker in running.workers) == 1
    assert sorted(found) == list(range(12)) and sum(steps) == 12
    assert all(found[number].result == number**2 for number in found if number not in (WRONG, ODD))
    assert found[DEADLY].result == 9
    assert isinstance(found[WRONG].error, UserError) and str(found[WRONG].error) == "5 is not liked"
    assert str(found[ODD].error) == "Pointed: odd", "an error that cannot be pickled is still told"


def test_a_cluster_writes_the_same_bytes(running, tmp_path, monkeypatch):
    try:
        Rasterizer((16, 16)).close()
    except UserError as error:
        pytest.skip(str(error))
    monkeypatch.setattr(synthesis, "SHARD_VIEWS", 1)
    monkeypatch.chdir(tmp_path)
    options = SynthesizeOptions(people=1, views=3, size=32, seed=5)
    calls: list[tuple[int, int]] = []
    assert synthesize("there", options, lambda _, *step: calls.append(step), scheduler=running.address) == 3
    assert calls == [(1, 3), (2, 3), (3, 3)]
    assert synthesize("here", options) == 3
    here, there = ({p.name: p.read_bytes() for p in (tmp_path / name).iterdir()} for name in ("here", "there"))
    assert here == there and len(here) == 4
    assert synthesize("there", options, scheduler=running.address) == 0, "nothing is left to do"


def test_workers_with_another_version_are_refused(running, tmp_path, monkeypatch):
    monkeypatch.setattr(cluster, "__version__", "9.9")
    with pytest.raises(UserError, match=r"^the worker tcp://.* has gazenerf [\d.]+, here it is 9\.9; install the same"):
        list(results(Squaring(tmp_path), range(2), Where(scheduler=running.address)))


def test_a_scheduler_that_dies_is_one_line_and_what_was_done_is_kept(running, tmp_path):
    found = []
    with pytest.raises(
        UserError, match=r"^the Dask scheduler at tcp://.* is gone; start it .* goes on where it stopped$"
    ):
        for done in results(Squaring(tmp_path), [1, 2, DEADLY, 4], Where(scheduler=running.address)):
            found.append(done.item)
            if len(found) == 2:
                wait_for(tmp_path / "process")
                running.scheduler.kill()
    assert found == [1, 2]


def wait_for(path: Path) -> None:
    until = time.monotonic() + PATIENCE_S
    while time.monotonic() < until and not path.is_file():
        time.sleep(0.02)


def test_a_scheduler_that_is_not_there_is_one_line(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(cluster, "CONNECT_SECONDS", 0.5)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
    with pytest.raises(UserError, match=rf"^no Dask scheduler answers at {address}; start one with `dask scheduler`"):
        list(results(Squaring(tmp_path), range(2), Where(scheduler=address)))
    assert capsys.readouterr().err == ""


def test_workers_that_cannot_be_used_are_refused(monkeypatch):
    client = SimpleNamespace(status="running", nthreads=lambda: {"tcp://a:1": 8})
    with pytest.raises(UserError, match=r"tcp://a:1 does 8 things at once.*`dask worker tcp://s:1 --nthreads 1"):
        cluster.Cluster(client, "tcp://s:1")
    client.nthreads, client.run = (lambda: {"tcp://a:1": 1}), lambda *_, **__: {"tcp://a:1": None}
    with pytest.raises(UserError, match="tcp://a:1 has no gazenerf, here it is"):
        cluster.Cluster(client, "tcp://s:1")
    client.nthreads = dict
    monkeypatch.setattr(cluster, "WORKERS_SECONDS", 0.0)
    with pytest.raises(UserError, match="has no workers; start some with `dask worker tcp://s:1 --nthreads 1"):
        cluster.Cluster(client, "tcp://s:1")
