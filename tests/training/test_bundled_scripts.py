"""The scripts behind the bundled field: what can be checked without its captures; `make dry-run` does the rest."""

from __future__ import annotations

import runpy
import subprocess
from pathlib import Path

import pytest

from gazenerf.data.storage import CaptureSet, read_manifest, write_manifest, write_shard
from gazenerf.errors import UserError

SCRIPTS = Path(__file__).parent.parent.parent / "scripts"


@pytest.fixture(scope="module")
def join():
    return runpy.run_path(str(SCRIPTS / "join_captures.py"))["join"]


def write_set(folder: Path, captures, people: int, views: int, **about) -> Path:
    folder.mkdir()
    write_manifest(folder, {"people": people, "views": views, "seed": 1, "code_sizes": [4, 3, 5, 27], **about})
    for person in range(people):
        write_shard(folder, [c for c in captures if c.person == person and c.view < views])
    return folder


def test_more_views_take_the_place_of_few_and_held_out_people_are_left_out(toy_captures, tmp_path, join):
    base = write_set(tmp_path / "base", toy_captures, people=2, views=2)
    more = write_set(tmp_path / "more", toy_captures, people=1, views=8)
    assert join(base, more, tmp_path / "all", set()) == 2
    found = [(capture.person, capture.view) for capture in CaptureSet(tmp_path / "all")]
    assert found == [*((0, view) for view in range(8)), (1, 0), (1, 1)]
    assert read_manifest(tmp_path / "all")["more_views"] == {"people": 1, "views": 8}
    assert join(base, more, tmp_path / "all", set()) == 2, "doing it again changes nothing"
    join(base, more, tmp_path / "some", {0})
    assert CaptureSet(tmp_path / "some").people == [1]
    assert CaptureSet(base).people == [0, 1] and len(CaptureSet(base)) == 4, "the sets themselves stay"


def test_sets_of_other_people_are_not_joined(toy_captures, tmp_path, join):
    base = write_set(tmp_path / "base", toy_captures, people=1, views=2)
    more = write_set(tmp_path / "more", toy_captures, people=1, views=2, supersampling=3)
    with pytest.raises(UserError, match="differ in supersampling"):
        join(base, more, tmp_path / "all", set())
    with pytest.raises(UserError, match="no captures"):
        join(base, tmp_path / "nowhere", tmp_path / "all", set())


@pytest.mark.parametrize("words", [[], ["--dry-run"]])
def test_the_chain_needs_a_folder(words: list[str]):
    done = subprocess.run(["bash", SCRIPTS / "train_bundled.sh", *words], capture_output=True, text=True, timeout=60)
    assert done.returncode == 2 and done.stderr.count("\n") == 1 and "folder" in done.stderr
