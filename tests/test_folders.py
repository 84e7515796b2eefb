"""Folders by URL: copies for reading, files that are sent whole, and what a killed run leaves on an FTP server."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
import uuid
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest

from gazenerf import folders
from gazenerf.cli.main import main
from gazenerf.data import CaptureSet, SynthesizeOptions, synthesize
from gazenerf.data.rasterizer import Rasterizer
from gazenerf.errors import UserError
from gazenerf.files import whole_file
from gazenerf.folders import folder_of, local_copy, names_in, reach

pytest.importorskip("upath", reason="needs gazenerf[urls]")

ROOT = Path(__file__).parents[1]


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch) -> Path:
    monkeypatch.setenv("GAZENERF_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture
def memory():
    return folder_of(f"memory://{uuid.uuid4().hex}/set")


@pytest.fixture
def served(tmp_path) -> Iterator[SimpleNamespace]:
    """An FTP server on the loopback address, with its folder; `may` changes what a user may do there."""
    servers = pytest.importorskip("pyftpdlib.servers", reason="needs pyftpdlib")
    from pyftpdlib.authorizers import DummyAuthorizer
    from pyftpdlib.handlers import FTPHandler

    root, users = tmp_path / "served", DummyAuthorizer()
    root.mkdir()
    users.add_user("user", "secret", str(root), perm="elradfmwMT")
    server = servers.FTPServer(("127.0.0.1", 0), type("Handler", (FTPHandler,), {"authorizer": users}))
    thread = threading.Thread(target=server.serve_forever, kwargs={"timeout": 0.05, "handle_exit": False})
    thread.start()

    def may(permissions: str) -> None:
        users.user_table["user"]["perm"] = permissions

    yield SimpleNamespace(root=root, url=f"ftp://user:secret@127.0.0.1:{server.address[1]}/set", may=may)
    server.close_all()
    thread.join(10)


@pytest.fixture
def pyrender() -> None:
    try:
        Rasterizer((16, 16)).close()
    except UserError as error:
        pytest.skip(str(error))


def write(file, text: str) -> None:
    with whole_file(file) as temporary:
        temporary.write_text(text)


def test_paths_stay_paths(tmp_path):
    assert folder_of(str(tmp_path)) == folder_of(f"file://{tmp_path}") == local_copy(f"local://{tmp_path}") == tmp_path
    assert names_in(tmp_path / "none") == set()


def test_of_a_copy_only_what_is_new_or_changed_is_fetched_again(memory, cache, monkeypatch):
    for name, text in (("a.txt", "one"), ("below/b.txt", "two"), (".half-b.txt", "half")):
        write(memory / name, text)
    copy = local_copy(str(memory))
    assert copy.is_relative_to(cache) and sorted(p.name for p in copy.rglob("*.txt")) == ["a.txt", "b.txt"]
    fetched, get = [], type(memory.fs).get
    monkeypatch.setattr(
        type(memory.fs), "get", lambda self, names, *more: fetched.extend(names) or get(self, names, *more)
    )
    assert local_copy(memory) == copy and not fetched
    write(memory / "a.txt", "new")
    (memory / "below" / "b.txt").unlink()
    assert (local_copy(memory) / "a.txt").read_text() == "new" and fetched == [(memory / "a.txt").path]
    assert not (copy / "below" / "b.txt").exists()


def test_a_copy_that_was_cut_short_goes_on(memory, monkeypatch):
    monkeypatch.setattr(folders, "AT_ONCE", 2)
    for number in range(5):
        write(memory / f"{number}.txt", str(number))
    fetched, get = [], type(memory.fs).get

    def breaking(self, names, *more):
        if len(fetched) == 2:
            fetched.append("broke")
            raise ConnectionResetError("the line broke")
        fetched.extend(names)
        return get(self, names, *more)

    monkeypatch.setattr(type(memory.fs), "get", breaking)
    with pytest.raises(UserError, match=r"cannot copy memory://.* \(ConnectionResetError: the line broke\)"):
        local_copy(memory)
    copy = local_copy(memory)
    assert {path.read_text() for path in copy.iterdir()} == set("01234")
    assert len(fetched) == 6, "what had come was not fetched again"


def test_names_that_lead_out_are_refused(memory):
    write(memory / "a.txt", "one")
    listing = {f"{memory.path}/../../x": {"type": "file"}}
    system = SimpleNamespace(find=lambda *_, **__: listing)
    with pytest.raises(UserError, match="which leads out of it"):
        folders._listed(SimpleNamespace(path=memory.path, fs=system))


def test_a_file_that_cannot_be_sent_leaves_nothing(served):
    folder = folder_of(served.url)
    write(folder / "kept.txt", "old")
    served.may("elr")
    with pytest.raises(UserError, match=r"cannot write ftp://.*kept.txt .*check what you may do there"):
        write(folder / "kept.txt", "new")
    assert {path.name: path.read_text() for path in (served.root / "set").iterdir()} == {"kept.txt": "old"}
    served.may("elradfmwMT")
    write(folder / "kept.txt", "new and longer")
    assert (folder / "kept.txt").read_text() == "new and longer", "no listing of before is believed"


def test_captures_are_the_same_by_url(pyrender, memory, tmp_path):
    few = SynthesizeOptions(people=2, views=3, size=32, seed=5)
    assert synthesize(str(memory), few) == synthesize(tmp_path / "here", few) == 6
    assert synthesize(str(memory), few) == 0, "what is there is not rendered again"
    for file in (tmp_path / "here").iterdir():
        assert (memory / file.name).read_bytes() == file.read_bytes()
    assert CaptureSet(str(memory)).people == [0, 1]
    with pytest.raises(UserError, match="holds other captures"):
        synthesize(str(memory), SynthesizeOptions(people=2, views=3, size=16))


def test_a_killed_run_leaves_whole_files_and_goes_on(pyrender, served, tmp_path):
    words = ["synthesize", "--people", "3", "--views", "8", "--size", "16", "--workers", "1", "--out"]
    command = [sys.executable, "-m", "gazenerf", *words, served.url]
    environment = os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    running = subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL)
    until = time.monotonic() + 120
    while not list(served.root.glob("set/person-*.npz")):
        assert running.poll() is None and time.monotonic() < until, running.stderr and running.stderr.read()
        time.sleep(0.02)
    running.send_signal(signal.SIGKILL)
    running.wait()
    first = {path.name: path.stat().st_mtime_ns for path in served.root.glob("set/person-*.npz")}
    assert 1 <= len(first) < 3
    assert main([*words, served.url]) == 0 and main([*words, str(tmp_path / "here")]) == 0
    for file in (tmp_path / "here").iterdir():
        assert (served.root / "set" / file.name).read_bytes() == file.read_bytes()
    assert first.items() <= {path.name: path.stat().st_mtime_ns for path in served.root.glob("set/*")}.items()
    assert len(CaptureSet(served.url)) == 24


def refused(capsys, *words: str) -> str:
    try:
        code = main(list(words))
    except SystemExit as stop:  # by the parser
        code = stop.code
    assert code == 2
    return capsys.readouterr().err.strip().splitlines()[-1]


def test_urls_that_cannot_be_used_are_one_line(capsys, memory, monkeypatch, tmp_path):
    assert "nope:// is no kind of URL" in refused(capsys, "synthesize", "--out", "nope://bucket/set")
    said = refused(capsys, "synthesize", "--people", "1", "--views", "1", "--out", "ftp://127.0.0.1:1/set")
    assert "cannot reach ftp://" in said and "check address, network and credentials" in said
    assert "there is nothing at memory://" in refused(capsys, "evaluate", "--data", str(memory), "--out", "x.json")
    said = refused(capsys, "train", "--data", str(memory), "--out", "memory://run")
    assert "memory://run is a URL, and a path is meant (docs/captures.md#folders-elsewhere)" in said
    said = refused(capsys, "redirect", "a.png", "--gaze", "0", "5", "--out", "memory://b.png")
    assert "of one photograph or video the result is written here" in said
    with pytest.raises(UserError, match=r"lost a slash as a pathlib\.Path; give the URL as text"):
        CaptureSet(Path("s3://bucket/set"))
    monkeypatch.setitem(sys.modules, "s3fs", None)
    with pytest.raises(UserError, match=r"s3:// needs another package \(ImportError: Install s3fs"):
        folder_of("s3://bucket/set")
    monkeypatch.setitem(sys.modules, "upath", None)
    assert "folders by URL need: pip install 'gazenerf[urls]'" in refused(capsys, "synthesize", "--out", "memory://x")
    assert not list(tmp_path.glob("*.json"))


def test_what_is_not_there_yet_can_be_reached(memory):
    reach(memory)
    assert names_in(memory) == set()
