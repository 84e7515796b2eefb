"""What is refused before anything is trained."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from gazenerf.errors import UserError
from gazenerf.evaluation.pairs import save_pairs
from gazenerf.experiments.checked import OWN, checked_data
from gazenerf.experiments.options import ExperimentOptions

from .conftest import write_toys


def test_people_held_out_are_measured_and_other_sets_whole(options: ExperimentOptions, tmp_path):
    data = checked_data(options)
    assert data.people == 3 and data.tests == (data.own,) and data.own.pairs.people == [2]
    other = write_toys(tmp_path / "other", people=2, seed=5)
    cross = checked_data(replace(options, experiment="cross", test=(f"lab={other}",)))
    [test] = cross.tests
    assert test.name == "lab" and test.people == 2 and test.pairs.people == [0, 1]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"held_out": 3}, "holds 3 people and --held-out is 3"),
        ({"held_out": 0}, "--held-out must be at least 1"),
        ({"limit": 0}, "--limit must be"),
        ({"seed": -1}, "--seed must be"),
        ({"minutes": 0.0}, "--minutes must be above 0"),
        ({"estimator_epochs": 0}, "--estimator-epochs"),
        ({"real": (0, 1)}, "--real takes numbers from 1"),
        ({"samples": 2}, "--samples more than"),
        ({"experiment": "cross"}, "--test NAME=DIR"),
        ({"experiment": "cross", "test": ("lab",)}, "write NAME=DIR"),
        ({"experiment": "cross", "test": ("lab=/nowhere",)}, "there is no folder /nowhere"),
        ({"experiment": "cross", "test": ("held-out=.",)}, "choose another"),
        ({"test": ("lab=.",)}, "--test is of the experiment cross"),
    ],
)
def test_mistakes_are_one_line(options: ExperimentOptions, changes, message):
    with pytest.raises(UserError, match=message):
        checked_data(replace(options, **changes))


def test_sets_of_another_size_are_refused(options: ExperimentOptions, tmp_path):
    other = write_toys(tmp_path / "large", people=1, size=64)
    with pytest.raises(UserError, match="are 64 px, those of --data 32 px"):
        checked_data(replace(options, experiment="cross", test=(f"lab={other}",)))


def test_pairs_of_other_data_or_another_seed_are_refused(options: ExperimentOptions, tmp_path):
    data = checked_data(options)
    save_pairs(data.own.pairs, data.own.file)
    assert checked_data(options).own.pairs == data.own.pairs
    with pytest.raises(UserError, match="drawn with --seed 0, not 4"):
        checked_data(replace(options, seed=4))
    said = json.loads(data.own.file.read_text())
    data.own.file.write_text(json.dumps(said | {"data": "0123"}))
    with pytest.raises(UserError, match="other data"):
        checked_data(options)
    assert data.own.file.stem == OWN
