"""Which rows there are, and the paper's numbers of them."""

from __future__ import annotations

import pytest

from gazenerf.errors import UserError
from gazenerf.experiments.published import published
from gazenerf.experiments.rows import EXPERIMENTS, TRAININGS, chosen_rows, title_of
from gazenerf.experiments.tables import COLUMNS


def test_every_row_has_a_training_and_the_papers_name_and_numbers():
    for name, experiment in EXPERIMENTS.items():
        assert set(experiment.rows) <= set(TRAININGS)
        for found in published()[name].sets.values():
            assert tuple(found) == experiment.rows
            assert all(set(numbers) <= set(COLUMNS) for numbers in found.values())
        assert all(title_of(name, row) for row in experiment.rows)


def test_numbers_stand_under_their_headings():
    tables = {name: table.sets for name, table in published().items()}
    whole = tables["within"]["ETH-XGaze"]["gazenerf"]
    assert whole["gaze_deg"] == 6.944 and whole["head_deg"] == 3.47 and whole["identity_similarity"] == 45.207
    for name, row in (("ablation", "gazenerf"), ("losses", "R+P+D+F"), ("pretrained", "gazenerf")):
        assert tables[name]["ETH-XGaze"][row] == whole, "the paper's own model is in four of its tables"
    assert tables["cross"]["ColumbiaGaze"]["gazenerf"]["lpips"] == 0.352
    assert tables["within"]["ETH-XGaze"]["headnerf"]["fid"] == 69.487


def test_rows_are_chosen_by_name_in_the_tables_order():
    assert chosen_rows("within", ("gazenerf", "sted")) == ("sted", "gazenerf")
    with pytest.raises(UserError, match=r"no such row \(did you mean headnerf\?\)"):
        chosen_rows("within", ("hednerf",))
    with pytest.raises(UserError, match=r"did you mean calibration\?"):
        chosen_rows("calibraton", ())
