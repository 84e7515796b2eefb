from __future__ import annotations

from benchmarks.bind import measure_bind
from gazenerf.checkpoints import load_field
from gazenerf.subjects import bundled_subjects, load_subject


def test_another_gaze_is_much_cheaper_than_another_subject() -> None:
    found = measure_bind(load_field(), load_subject(next(iter(bundled_subjects()))), gazes=40)
    assert 10 * found["new_gaze"] < found["first"] and 10 * found["new_gaze_baked"] < found["bake"]
