"""The server starts or says in one line why not, and ends on Ctrl-C with nothing left behind."""

import os
import signal
import socket
import subprocess
import sys
import threading
import urllib.request

import pytest

from gazenerf.cli.main import main
from gazenerf.errors import UserError
from gazenerf.viz.viewer.commands import Source
from gazenerf.viz.viewer.server import check_port, has_desktop, serving
from tests.viz.viewer.doubles import FlatHead


@pytest.fixture
def taken():
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        yield other.getsockname()[1]


def test_a_taken_port_is_one_line_that_names_it_before_a_field_is_loaded(taken, capsys):
    assert main(["view", "--port", str(taken), "--checkpoint", "not-there.safetensors"]) == 2
    error = capsys.readouterr().err
    assert f"127.0.0.1:{taken}" in error and "--port 0" in error and error.count("\n") == 1


@pytest.mark.parametrize(("host", "port"), [("127.0.0.1", 65536), ("127.0.0.1", -1), ("256.0.0.1", 0), ("no host", 0)])
def test_addresses_that_cannot_be_are_refused(host, port):
    with pytest.raises(UserError, match=r"--(port|host)"):
        check_port(host, port)


def test_without_viser_the_extra_is_named(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "viser", None)
    assert main(["view", "--port", "0"]) == 2
    error = capsys.readouterr().err
    assert "gazenerf[viewer]" in error and error.count("\n") == 1


def test_a_subject_that_does_not_fit_is_one_line(tmp_path, capsys):
    pytest.importorskip("viser", reason="viser is not installed")
    path = tmp_path / "flat.safetensors"
    FlatHead().subject.save(path)
    assert main(["view", "--port", "0", "--checkpoint", "small", "--subject", str(path)]) == 2
    error = capsys.readouterr().err
    assert "codes" in error and error.count("\n") == 1


@pytest.mark.parametrize("variable", ["DISPLAY", "WAYLAND_DISPLAY"])
@pytest.mark.skipif(sys.platform in ("darwin", "win32"), reason="these always have a desktop")
def test_a_browser_is_opened_only_where_there_is_a_desktop(variable, monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    assert not has_desktop()
    monkeypatch.setenv(variable, ":0")
    assert has_desktop()


def test_it_serves_a_page_and_leaves_no_thread_behind():
    pytest.importorskip("viser", reason="viser is not installed")
    before = {thread for thread in threading.enumerate() if thread.name.startswith("viewer")}
    with serving(FlatHead(), Source(), port=0) as (page, address):
        assert page.visits == {}
        with urllib.request.urlopen(address, timeout=20) as answer:
            assert b"<html" in answer.read()[:4000].lower()
        port = int(address.rpartition(":")[2])
        with pytest.raises(UserError, match=str(port)):
            check_port("127.0.0.1", port)
    assert {thread for thread in threading.enumerate() if thread.name.startswith("viewer")} == before
    check_port("127.0.0.1", port)


def test_ctrl_c_ends_it_with_exit_code_0():
    pytest.importorskip("viser", reason="viser is not installed")
    command = [sys.executable, "-m", "gazenerf", "view", "--checkpoint", "small", "--port", "0"]
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    environment.pop("DISPLAY", None)

    def listen() -> None:  # tests that a shell runs in the background ignore Ctrl-C, and so would what they start
        signal.signal(signal.SIGINT, signal.SIG_DFL)

    viewer = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment, preexec_fn=listen
    )
    try:
        assert viewer.stdout is not None
        line = viewer.stdout.readline()
        assert line.startswith("gazenerf view: http://127.0.0.1:")
        viewer.send_signal(signal.SIGINT)
        out, error = viewer.communicate(timeout=60)
    finally:
        viewer.kill()
    assert viewer.returncode == 0 and error == "" and out == ""
