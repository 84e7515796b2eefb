"""`gazenerf prepare` from its words to its tables, and what it refuses in one line."""

from __future__ import annotations

import json

import numpy as np
import pytest
from PIL import Image

from benchmarks.published_sets import write_eth_xgaze
from gazenerf.cli.main import main
from gazenerf.data.rasterizer import Rasterizer
from gazenerf.errors import UserError


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    pytest.importorskip("h5py")
    try:
        Rasterizer((16, 16)).close()
    except UserError as error:
        pytest.skip(str(error))
    folder = tmp_path_factory.mktemp("published") / "xgaze"
    write_eth_xgaze(folder, 1, 2, size=96)
    return folder


def prepare(root, *words: str) -> int:
    return main(["prepare", "--dataset", "eth-xgaze", "--root", str(root), "--landmarks", "dataset", *words])


def test_the_check_counts_and_writes_pictures(root, tmp_path, capsys):
    arrows, pictures = tmp_path / "arrows.png", tmp_path / "pictures"
    assert prepare(root, "--check", "--arrows", str(arrows), "--write-pictures", str(pictures), "--json") == 0
    said = json.loads(capsys.readouterr().out)
    assert said["measured"]["pictures"] == 2 and said["measured"]["subjects"] == said["measured"]["wanted"] == 1
    shown = np.array(Image.open(arrows))
    assert shown.shape[1] == 512 and (shown == (255, 214, 10)).all(axis=-1).sum() > 50, "yellow arrows"
    assert [path.name for path in sorted(pictures.rglob("*.png"))] == ["frame0000-cam00.png", "frame0000-cam01.png"]
    assert prepare(root, "--check", "--write-pictures", str(pictures)) == 0, "what is there stays"
    assert "nothing" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "line"),
    [
        ([], "give --out DIR for the captures, or --check"),
        (["--out", "x", "--arrows", "a.png"], "--arrows goes with --check"),
        (
            ["--check", "--subjects", "subject0009"],
            "the split has no subject 'subject0009' (did you mean subject0000?)",
        ),
        (["--check", "--split", "test"], "subject0001.h5 does not exist; download it, or leave the subject out"),
        (["--check", "--pictures", "0"], "--pictures must be at least 1"),
    ],
)
def test_mistakes_are_one_line(root, words, line, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert prepare(root, *words) == 2
    (said,) = capsys.readouterr().err.strip().splitlines()
    assert line in said and not list(tmp_path.iterdir())


def test_only_known_data_sets(root, capsys):
    with pytest.raises(SystemExit):
        main(["prepare", "--dataset", "eth-gaze", "--root", str(root), "--check"])
    assert "did you mean eth-xgaze?" in capsys.readouterr().err
