"""`gazenerf synthesize` from its words to its table."""

from __future__ import annotations

import json

import pytest

from gazenerf.cli.main import main
from gazenerf.data.path_tracer import PathTracer
from gazenerf.data.rasterizer import Rasterizer
from gazenerf.errors import UserError

SMALL = ["--people", "1", "--views", "2", "--size", "16"]


def start(renderer: str) -> None:
    try:
        Rasterizer((16, 16)).close() if renderer == "pyrender" else PathTracer((16, 16))
    except UserError as error:
        pytest.skip(str(error))


@pytest.mark.parametrize(
    ("words", "samples"),
    [(["--renderer", "mitsuba", "--samples", "2"], {"samples": 2}), ([], {"supersampling": 2})],
)
def test_captures_are_written_and_counted(words, samples, tmp_path, capsys):
    renderer = "mitsuba" if words else "pyrender"
    start(renderer)
    assert main(["synthesize", "--out", str(tmp_path), *SMALL, *words]) == 0
    assert f"2 by {renderer}" in capsys.readouterr().out
    manifest = json.loads((tmp_path / "manifest.json").read_text())
    assert manifest["renderer"] == renderer and samples.items() <= manifest.items()
    assert main(["synthesize", "--out", str(tmp_path), *SMALL, *words]) == 0
    assert f"0 by {renderer}" in capsys.readouterr().out
    assert main(["synthesize", "--out", str(tmp_path), *SMALL, *words, "--seed", "1"]) == 2
    assert "seed 0, not 1" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["--samples", "8"], "--samples is a setting of --renderer mitsuba"),
        (["--renderer", "mitsuba", "--supersampling", "2"], "--supersampling is a setting of --renderer pyrender"),
        (["--renderer", "mitsuba", "--samples", "0"], "--samples goes from 1"),
        (["--renderer", "povray"], "there are pyrender, mitsuba"),
        (["--supersampling", "0"], "--supersampling goes from 1"),
        (["--seed", "-1"], "--seed must be 0 or more"),
        (["--layout", "spiral"], "random, xgaze18"),
        (["--expressions", "smiles"], "all, few"),
        (["--people", "0"], "at least 1"),
    ],
)
def test_mistakes_are_one_line(words, line, tmp_path, capsys):
    assert main(["synthesize", "--out", str(tmp_path / "set"), *SMALL, *words]) == 2
    said = capsys.readouterr().err
    assert line in said and said.count("\n") == 1
    assert not (tmp_path / "set").exists()


@pytest.mark.parametrize(
    ("error", "package"),
    [
        (ImportError("libX11.so.6: cannot open shared object file"), "libx11-6"),
        (UserError("pyrender cannot open a context (('Unable to load EGL library', 'EGL'))"), "libegl1"),
        (UserError("mitsuba cannot be loaded (libGL.so.1: cannot open shared object file)"), "libgl1"),
    ],
)
def test_a_missing_library_is_named_with_its_package(error, package, tmp_path, capsys, monkeypatch):
    def fail(*_, **__):
        raise error

    monkeypatch.setattr("gazenerf.cli.synthesize.synthesize", fail)
    assert main(["synthesize", "--out", str(tmp_path), *SMALL]) == 2
    assert f"apt-get install {package}" in capsys.readouterr().err
