from __future__ import annotations

import numpy as np

from benchmarks.train import PARTS, analytic_captures, measure_steps
from gazenerf.field.config import PRESETS


def test_captures_show_a_face_and_two_eyes() -> None:
    capture = analytic_captures(PRESETS["tiny"], 1)[0]
    shares = np.bincount(capture.parts.ravel(), minlength=4) / capture.parts.size
    assert (shares > 0).all() and shares[1] > 0.2 and shares[2] < 0.05


def test_a_step_is_split_into_its_parts() -> None:
    found = measure_steps("tiny", steps=2)
    assert set(found["seconds"]) == set(PARTS) and min(found["seconds"].values()) > 0
    assert found["steps_per_second"] == 1 / sum(found["seconds"].values())
