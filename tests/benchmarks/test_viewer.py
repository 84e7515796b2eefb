"""The benchmark of the viewer measures what it says."""

import gazenerf
from benchmarks.viewer import measure


def test_drags_sliders_and_visits_are_measured():
    found = measure(gazenerf.load("noa", "small"), seconds=1.0, visits=2, frames=6)
    assert found["drag_256"]["median_size"] == 256 and found["drag_256"]["full_size"] == 256
    assert found["drag_256"]["frames_per_second"] >= 1.0 and found["drag"]["frames_per_second"] >= 1.0
    slider = found["slider"]
    assert 0.0 < slider["first_picture_seconds"] <= slider["large_picture_seconds"] <= slider["full_picture_seconds"]
    assert slider["first_picture_seconds"] < slider["full_picture_seconds"]
    assert found["drag"]["full_after_release_seconds"] > 0.0
    assert found["memory"]["late_mib"] > 100.0
