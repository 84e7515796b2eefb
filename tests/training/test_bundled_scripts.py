"""The scripts behind the bundled field, and their whole chain at toy size."""

from __future__ import annotations

import json
import os
import runpy
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from gazenerf.checkpoints import BUNDLED, load_field, weights_hash
from gazenerf.data.rasterizer import Rasterizer
from gazenerf.data.storage import CaptureSet, read_manifest, write_manifest, write_shard
from gazenerf.errors import UserError
from gazenerf.field.config import PRESETS
from gazenerf.field.model import TwoStreamField

SCRIPTS = Path(__file__).parent.parent.parent / "scripts"


@pytest.fixture(scope="module")
def join():
    return runpy.run_path(str(SCRIPTS / "join_captures.py"))["join"]


def write_set(folder: Path, captures, people: int, views: int, **about) -> Path:
    folder.mkdir()
    write_manifest(folder, {"people": people, "views": views, "seed": 1, "code_sizes": [4, 3, 5, 27]} | about)
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


def test_other_people_are_numbered_on(toy_captures, tmp_path, join):
    base = write_set(tmp_path / "base", toy_captures, people=2, views=2)
    others = write_set(tmp_path / "others", toy_captures, people=2, views=2, seed=2)
    assert join(base, others, tmp_path / "all", {0}, others=True) == 3
    manifest = read_manifest(tmp_path / "all")
    assert CaptureSet(tmp_path / "all").people == [1, 2, 3]
    assert manifest["people"] == 4 and manifest["other_people"] == [
        {"people": 2, "views": 2, "seed": 2, "expressions": "few"}
    ]
    with pytest.raises(UserError, match="show the same people"):
        join(base, base, tmp_path / "twice", set(), others=True)


def test_a_joined_set_takes_in_more_people(toy_captures, tmp_path, join):
    sets = [
        write_set(tmp_path / str(seed), toy_captures, people=1 + (seed == 1), views=2, seed=seed) for seed in (1, 2, 3)
    ]
    join(sets[0], sets[1], tmp_path / "two", {1}, others=True)
    assert join(tmp_path / "two", sets[2], tmp_path / "three", set(), others=True) == 3
    manifest = read_manifest(tmp_path / "three")
    assert CaptureSet(tmp_path / "three").people == [0, 2, 3] and manifest["people"] == 4
    assert [some["seed"] for some in manifest["other_people"]] == [2, 3] and manifest["left_out"] == [1]
    for again in sets[:2]:
        with pytest.raises(UserError, match="show the same people"):
            join(tmp_path / "two", again, tmp_path / "twice", set(), others=True)


def test_sets_of_other_people_are_not_joined(toy_captures, tmp_path, join):
    base = write_set(tmp_path / "base", toy_captures, people=1, views=2)
    more = write_set(tmp_path / "more", toy_captures, people=1, views=2, supersampling=3)
    with pytest.raises(UserError, match="differ in supersampling"):
        join(base, more, tmp_path / "all", set())
    with pytest.raises(UserError, match="no captures"):
        join(base, tmp_path / "nowhere", tmp_path / "all", set())


def test_averaged_fields_lie_between_and_keep_what_the_last_one_says():
    average = runpy.run_path(str(SCRIPTS / "average_fields.py"))["average"]
    fields = []
    for seed in (1, 2):
        torch.manual_seed(seed)
        fields.append(TwoStreamField(replace(PRESETS["tiny"], trained_gaze_range=(10.0 * seed, 10.0))))
    first, second = ({name: value.clone() for name, value in field.state_dict().items()} for field in fields)
    found = average(fields, [0.25, 0.75])
    assert found.config.trained_gaze_range == (20.0, 10.0)
    for name, value in found.state_dict().items():
        torch.testing.assert_close(value, 0.25 * first[name] + 0.75 * second[name])
    for shares in ([0.5], [0.5, 0.6], [1.5, -0.5]):
        with pytest.raises(UserError, match="shares"):
            average(fields, shares)
    with pytest.raises(UserError, match="different networks"):
        average([fields[0], TwoStreamField(replace(PRESETS["tiny"], hidden=24))], [0.5, 0.5])


@pytest.mark.parametrize("words", [[], ["--dry-run"]])
@pytest.mark.parametrize("script", ["train_bundled.sh", "train_portrait_sdf.sh"])
def test_the_chain_needs_a_folder(script: str, words: list[str]):
    done = subprocess.run(["bash", SCRIPTS / script, *words], capture_output=True, text=True, timeout=60)
    assert done.returncode == 2 and done.stderr.count("\n") == 1 and "folder" in done.stderr


def test_the_dry_run_goes_from_captures_to_a_report(tmp_path):
    try:
        with Rasterizer((16, 16), 1):
            pass
    except UserError as error:
        pytest.skip(f"captures need off-screen OpenGL: {error}")
    assets = BUNDLED.parent.parent
    before = {path: path.stat().st_mtime_ns for path in assets.rglob("*")}
    bundled = weights_hash(BUNDLED)
    environment = os.environ | {"PYTHON": sys.executable, "PYTHONPATH": str(SCRIPTS.parent), "OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        ["bash", SCRIPTS / "train_bundled.sh", tmp_path / "all", "--dry-run"],
        capture_output=True, text=True, timeout=600, env=environment, cwd=tmp_path,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-2000:]
    field = load_field(tmp_path / "all" / "field.safetensors")
    assert field.about["preset"] == "portrait" and field.about["shaped_to_minutes"] == 0.05 and field.about["steps"] > 1
    report = json.loads((tmp_path / "all" / "quality.json").read_text())
    assert report["unseen_people"] == [12, 13] and report["trained"]["captures"] == 12
    assert len(list((tmp_path / "all" / "subjects").glob("*.safetensors"))) == 8
    assert [path.name for path in tmp_path.iterdir()] == ["all"], "nothing beside the folder"
    assert {path: path.stat().st_mtime_ns for path in assets.rglob("*")} == before and weights_hash(BUNDLED) == bundled
