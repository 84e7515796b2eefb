"""What is done lies beside the output, for one input and one set of options."""

from __future__ import annotations

import numpy as np
import pytest

from gazenerf.errors import UserError
from gazenerf.photographs.clips.work_folder import WorkFolder


def test_what_was_kept_is_there_for_the_same_question_only(tmp_path):
    out = tmp_path / "new.mp4"
    work = WorkFolder(out, {"gaze": (0.0, 1.0)}, False)
    assert not work.resumed and not work.has("a")
    work.keep("a", {"x": np.arange(3), "why": np.array("no face")})
    again = WorkFolder(out, {"gaze": [0.0, 1.0]}, False)
    assert again.resumed and again.has("a") and str(again.kept("a")["why"]) == "no face"
    with pytest.raises(UserError, match="other options; add --overwrite"):
        WorkFolder(out, {"gaze": (0.0, 2.0)}, False)
    assert not WorkFolder(out, {"gaze": (0.0, 2.0)}, True).has("a")


def test_damage_is_said_and_nothing_is_left_behind(tmp_path):
    work = WorkFolder(tmp_path / "new.mp4", {}, False)
    work.keep("a", {"x": np.arange(3)})
    data = (work.path / "a.npz").read_bytes()
    (work.path / "a.npz").write_bytes(data[: len(data) // 2])
    with pytest.raises(UserError, match="damaged"):
        work.kept("a")
    work.delete()
    assert not work.path.exists()
