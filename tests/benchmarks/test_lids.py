"""The benchmark of lids tells lids that are right from others."""

from __future__ import annotations

import pytest

from benchmarks import lids
from gazenerf.checkpoints import load_field
from gazenerf.errors import UserError
from gazenerf.subjects import load_subject


def test_lids_of_the_head_model_are_nearer_to_it_than_the_networks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lids, "CASES", ((0.0, -20.0), (1.0, 0.0)))
    try:
        rows, pictures = lids.measure(load_field("portrait-sdf"), [load_subject("gus")])
    except UserError as error:
        pytest.skip(str(error))
    lowered, shut = rows
    assert lowered["placed"] > lowered["alone"] + 1.0 and shut["placed"] > shut["alone"] + 1.0
    assert shut["upper"] is None and -35.0 < lowered["lower"] < lowered["upper"] < 0.0
    assert pictures.shape == (2 * 72, 4 * 220, 3)
