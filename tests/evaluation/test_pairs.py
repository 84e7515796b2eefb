"""Pairs are drawn once, saved, and refused for anything else."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gazenerf.errors import UserError
from gazenerf.evaluation.pairs import Pair, draw_pairs, identities_hash, load_pairs, save_pairs
from gazenerf.geometry import Gaze

from .made_captures import flat_capture

CAPTURES = [flat_capture(person, view) for person in range(3) for view in range(7)]


def test_every_view_is_used_once_and_the_seed_decides():
    pairs = draw_pairs(CAPTURES, [1, 2], seed=0)
    assert pairs.people == [1, 2] and len(pairs.pairs) == 6
    for person in (1, 2):
        used = [view for pair in pairs.pairs if pair.person == person for view in (pair.source, pair.target)]
        assert len(set(used)) == 6 and set(used) <= set(range(7))
    assert draw_pairs(list(reversed(CAPTURES)), [1, 2], seed=0) == pairs, "whatever the order of the captures"
    assert draw_pairs(CAPTURES, [1, 2], seed=1).pairs != pairs.pairs
    assert draw_pairs(CAPTURES, [2], seed=0).pairs == tuple(p for p in pairs.pairs if p.person == 2)
    assert [pair.person for pair in pairs.first(2)] == [1, 1, 2, 2] and pairs.first(None) == list(pairs.pairs)


def test_captures_from_behind_are_in_no_pair():
    behind = [replace(c, parts=np.minimum(c.parts, 1)) if c.view < 6 else c for c in CAPTURES]
    with pytest.raises(UserError, match="two captures that show an eye"):
        draw_pairs(behind, [0, 1, 2], seed=0)
    turned = [replace(c, parts=np.minimum(c.parts, 1)) if c.view == 3 else c for c in CAPTURES]
    used = {view for pair in draw_pairs(turned, [0], seed=0).pairs for view in (pair.source, pair.target)}
    assert used == {0, 1, 2, 4, 5, 6}


def test_what_was_saved_comes_back(tmp_path: Path):
    pairs = draw_pairs(CAPTURES, [1, 2], seed=4)
    save_pairs(pairs, tmp_path / "p.json")
    loaded = load_pairs(tmp_path / "p.json", CAPTURES, [1, 2])
    assert loaded == pairs and loaded.hash == pairs.hash
    assert load_pairs(tmp_path / "p.json", list(reversed(CAPTURES)), [0, 1, 2]) == pairs


@pytest.mark.parametrize(
    "other",
    [
        CAPTURES[:-1],
        [*CAPTURES[:-1], replace(CAPTURES[-1], gaze=Gaze(0.3, 0.3))],
        [*CAPTURES[:-1], flat_capture(2, 9)],
        [*CAPTURES[:-1], replace(CAPTURES[-1], camera=CAPTURES[0].camera)],
    ],
    ids=["one less", "another gaze", "another view", "another camera"],
)
def test_pairs_of_other_data_are_refused(other, tmp_path: Path):
    save_pairs(draw_pairs(CAPTURES, [1, 2], seed=0), tmp_path / "p.json")
    assert identities_hash(other) != identities_hash(CAPTURES)
    with pytest.raises(UserError, match="captures of other data"):
        load_pairs(tmp_path / "p.json", other, [1, 2])


def test_people_that_were_trained_on_are_refused(tmp_path: Path):
    save_pairs(draw_pairs(CAPTURES, [1, 2], seed=0), tmp_path / "p.json")
    with pytest.raises(UserError, match="person 1, who is not held out"):
        load_pairs(tmp_path / "p.json", CAPTURES, [2])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"format": "gazenerf-captures-1"}, "not a file of pairs"),
        ({"pairs": {"1": [[0, 99]]}}, "are no two captures"),
        ({"pairs": {"1": [[0, 0]]}}, "are no two captures"),
        ({"pairs": {"1": [[0, 1], [0, 1]]}}, "there twice"),
        ({"pairs": {"1": [[0]]}}, "damaged"),
        ({"pairs": {"one": [[0, 1]]}}, "damaged"),
        ({"pairs": {"1": [[True, "2"]]}}, "is no index"),
        ({"pairs": {}}, "no pair"),
        ({"pairs": [1]}, "damaged"),
        ({"seed": None}, "is no index"),
    ],
)
def test_damaged_files_are_one_line(change, message, tmp_path: Path):
    path = tmp_path / "p.json"
    save_pairs(draw_pairs(CAPTURES, [1, 2], seed=0), path)
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(UserError, match=message) as said:
        load_pairs(path, CAPTURES, [1, 2])
    assert "\n" not in str(said.value)
    path.write_text("{")
    with pytest.raises(UserError, match="cannot be read as JSON"):
        load_pairs(path, CAPTURES, [1, 2])


def test_a_pair_names_itself():
    assert Pair(3, 5, 1).name == "person 3 view 5 to 1"
