"""Sets of captures: the same bytes from the same seed, however often they are interrupted."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import multiprocessing
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from gazenerf.data import CaptureSet, SynthesizeOptions, storage, synthesis, synthesize
from gazenerf.errors import UserError

SIZE = 32
SETTINGS = {"people": 2, "views": 3, "size": SIZE, "seed": 5}


def digests(folder: Path) -> dict[str, str]:
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in folder.iterdir()}


@pytest.fixture
def small_shards(monkeypatch) -> None:
    monkeypatch.setattr(synthesis, "SHARD_VIEWS", 2)


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    """A finished set in shards of two views."""
    folder = tmp_path_factory.mktemp("captures")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(synthesis, "SHARD_VIEWS", 2)
        try:
            assert synthesize(folder, SynthesizeOptions(**SETTINGS)) == 6
        except UserError as error:
            pytest.skip(str(error))
    return folder


def test_the_same_seed_gives_the_same_bytes(whole, small_shards, tmp_path):
    synthesize(tmp_path, SynthesizeOptions(**SETTINGS))
    assert digests(tmp_path) == digests(whole)
    assert len(digests(whole)) == 1 + 2 * 2


def test_another_seed_gives_other_pictures(whole, small_shards, tmp_path):
    synthesize(tmp_path, SynthesizeOptions(**SETTINGS | {"seed": 6, "people": 1, "views": 2}))
    same = digests(whole).items() & digests(tmp_path).items()
    assert not same


def test_what_is_missing_is_made_again_and_what_is_there_stays(whole, small_shards, tmp_path):
    synthesize(tmp_path, SynthesizeOptions(**SETTINGS))
    names = sorted(path.name for path in tmp_path.glob("person-*.npz"))
    (tmp_path / names[1]).unlink()
    kept = (tmp_path / names[0]).stat().st_mtime_ns
    calls = []
    assert (
        synthesize(tmp_path, SynthesizeOptions(**SETTINGS), lambda stage, done, total: calls.append((done, total))) == 1
    )
    assert digests(tmp_path) == digests(whole)
    assert (tmp_path / names[0]).stat().st_mtime_ns == kept and calls == [(6, 6)]
    assert synthesize(tmp_path, SynthesizeOptions(**SETTINGS)) == 0


def test_a_killed_run_goes_on_where_it_stopped(whole, small_shards, tmp_path):
    program = (
        "import sys; from gazenerf.data import synthesis; synthesis.SHARD_VIEWS = 2; "
        f"synthesis.synthesize(sys.argv[1], synthesis.SynthesizeOptions(**{SETTINGS}))"
    )
    with subprocess.Popen([sys.executable, "-c", program, str(tmp_path)]) as process:
        until = time.monotonic() + 60
        while process.poll() is None and time.monotonic() < until and not list(tmp_path.glob("person-*.npz")):
            time.sleep(0.02)
        process.kill()
    assert 0 < len(list(tmp_path.glob("person-*.npz"))) < 4
    (tmp_path / ".person-0001-view-00000-torn.npz").write_bytes(b"what a kill can leave")
    assert synthesize(tmp_path, SynthesizeOptions(**SETTINGS)) > 0
    assert {name: digest for name, digest in digests(tmp_path).items() if name[0] != "."} == digests(whole)
    assert len(CaptureSet(tmp_path)) == 6


def test_processes_write_the_same_bytes(whole, small_shards, tmp_path):
    calls = []
    rendered = synthesize(
        tmp_path, SynthesizeOptions(**SETTINGS), lambda stage, done, total: calls.append((done, total)), workers=2
    )
    assert rendered == 6 and digests(tmp_path) == digests(whole)
    assert len(calls) == 4 and calls[-1] == (6, 6), "a call for each shard"


def test_a_process_that_dies_is_one_line_and_the_set_goes_on(pyrender, small_shards, tmp_path):
    options = SynthesizeOptions(**SETTINGS | {"people": 1, "views": 24})

    def kill(stage: str, done: int, total: int) -> None:
        for child in multiprocessing.active_children():
            child.kill()

    with pytest.raises(UserError, match="smaller --workers"):
        synthesize(tmp_path, options, kill, workers=2)
    there = len(list(tmp_path.glob("person-*.npz")))
    assert 1 <= there < 12
    assert synthesize(tmp_path, options) == 24 - 2 * there
    assert len(CaptureSet(tmp_path)) == 24


def test_captures_read_back_as_they_were_rendered(whole, head):
    captures = CaptureSet(whole)
    assert len(captures) == 6 and captures.people == [0, 1]
    manifest = json.loads((whole / storage.MANIFEST).read_text())
    assert manifest["renderer"] == "pyrender" and manifest["supersampling"] == 2
    assert manifest["expressions"] == "all"
    view = synthesis.plan_view(head, 5, 1, 2, SIZE)
    with synthesis.Rasterizer((SIZE, SIZE), 2) as rasterizer:
        fresh = synthesis.render_capture(rasterizer, head, view)
    (stored,) = (capture for capture in captures if (capture.person, capture.view) == (1, 2))
    np.testing.assert_array_equal(stored.image, fresh.image)
    np.testing.assert_array_equal(stored.parts, fresh.parts)
    np.testing.assert_allclose(stored.depth, fresh.depth, atol=0.51 * storage.DEPTH_STEP)
    assert stored.gaze == view.gaze
    np.testing.assert_array_equal(stored.camera.world_from_camera, view.camera.world_from_camera)
    np.testing.assert_array_equal(stored.codes.texture, view.codes.texture)
    np.testing.assert_array_equal(stored.head_mask, stored.face_mask | stored.eyes_mask)


def test_xgaze18_is_written_too(pyrender, tmp_path):
    assert synthesize(tmp_path, SynthesizeOptions(people=1, views=3, size=16, seed=0, layout="xgaze18")) == 3
    captures = CaptureSet(tmp_path)[:]
    assert len({capture.gaze for capture in captures}) == 1
    assert [float(np.sign(capture.camera.position[0])) for capture in captures] == [-1.0, -1.0, -1.0]


@pytest.mark.parametrize("workers", [0, -1])
def test_no_processes_are_refused(workers, tmp_path):
    with pytest.raises(UserError, match="--workers must be at least 1"):
        synthesize(tmp_path / "set", SynthesizeOptions(**SETTINGS), workers=workers)
    assert not (tmp_path / "set").exists()


def test_path_traced_sets_are_the_same_every_time_and_keep_apart(path_tracer, whole, tmp_path, monkeypatch):
    monkeypatch.setattr(synthesis, "SHARD_VIEWS", 1)
    traced: dict = {"renderer": "mitsuba", "samples": 3}
    few: dict = {"people": 1, "views": 2, "size": SIZE, "seed": 5}
    for name, workers in (("a", 1), ("b", 2)):
        assert synthesize(tmp_path / name, SynthesizeOptions(**few, **traced), workers=workers) == 2
    assert digests(tmp_path / "a") == digests(tmp_path / "b")
    manifest = json.loads((tmp_path / "a" / storage.MANIFEST).read_text())
    assert manifest["renderer"] == "mitsuba" and manifest["samples"] == 3 and "supersampling" not in manifest
    assert synthesize(tmp_path / "a", SynthesizeOptions(**few, **traced)) == 0
    with pytest.raises(UserError, match=r"samples 3, not 4\); choose another --out"):
        synthesize(tmp_path / "a", SynthesizeOptions(**few, renderer="mitsuba", samples=4))
    with pytest.raises(UserError, match=r"renderer pyrender, not mitsuba\)"):
        synthesize(whole, SynthesizeOptions(**SETTINGS, **traced))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"people": 0}, "at least 1"),
        ({"views": 0}, "at least 1"),
        ({"size": 8}, "between 16 and"),
        ({"seed": -1}, "0 or more"),
        ({"layout": "spiral"}, "unknown --layout"),
        ({"renderer": "povray"}, "pyrender, mitsuba"),
        ({"supersampling": 9}, "from 1 to 8"),
        ({"renderer": "mitsuba", "samples": 0}, "from 1 to 4096"),
    ],
)
def test_impossible_settings_are_refused_before_anything_is_written(change, words, tmp_path):
    with pytest.raises(UserError, match=words):
        synthesize(tmp_path / "set", SynthesizeOptions(**SETTINGS | change))
    assert not (tmp_path / "set").exists()


def test_a_set_older_than_the_choice_of_expressions_goes_on_with_few(pyrender, tmp_path):
    few = SynthesizeOptions(people=1, views=2, size=16, seed=1, expressions="few")
    assert synthesize(tmp_path, few) == 2
    path = tmp_path / storage.MANIFEST
    older = {key: value for key, value in json.loads(path.read_text()).items() if key != "expressions"}
    path.write_text(json.dumps(older))
    assert CaptureSet(tmp_path).manifest["expressions"] == "few"
    assert synthesize(tmp_path, few) == 0
    with pytest.raises(UserError, match="expressions few, not all"):
        synthesize(tmp_path, dataclasses.replace(few, expressions="all"))
