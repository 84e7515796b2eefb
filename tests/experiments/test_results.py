"""How rows differ."""

from __future__ import annotations

import pytest

from gazenerf.experiments.results import differences


def test_rows_are_compared_person_by_person():
    ours = {str(person): {"pairs": 2, "gaze_deg": 5.0 + person, "fid": 1.0} for person in range(4)}
    theirs = {str(person): {"pairs": 2, "gaze_deg": 7.0 + person + 0.1 * (-1) ** person} for person in range(4)}
    found = differences({"sted": theirs, "gazenerf": ours})
    assert found["from"] == "gazenerf" and list(found["rows"]["sted"]) == ["gaze_deg"]
    gaze = found["rows"]["sted"]["gaze_deg"]
    assert gaze["mean"] == pytest.approx(2.0) and 1.7 < gaze["low"] < gaze["high"] < 2.3
    assert differences({"gazenerf": ours}) == {}
