"""The orbit's gauges in a check, and the numbers they become."""

from __future__ import annotations

import math

import pytest

from gazenerf.viz.check.result import CheckResult
from gazenerf.viz.metrics import orbit_pictures as picture_gauges
from gazenerf.viz.metrics.colmap import NO_MODEL, StructureFromMotion
from gazenerf.viz.metrics.families import CHECK_DEFINITIONS, measured
from gazenerf.viz.metrics.orbit_pictures import measure_orbit, share_interval
from tests.textured_double import TexturedField


@pytest.fixture
def empty() -> CheckResult:
    return CheckResult(measured(CHECK_DEFINITIONS), (), (), (), {}, extra={"other": 1}, notes=("before",))


def test_an_exact_field_is_perfect_and_keeps_what_was_there(empty):
    result = measure_orbit(empty, TexturedField(), 128)
    assert result.metric("tsed_2px").value == 1.0 and result.metric("tsed_matches").value > 20.0
    assert result.metric("sfm_registered").verdict == "unmeasured" and math.isnan(
        result.metric("depth_median_mm").value
    )
    assert result.extra["other"] == 1 and len(result.extra["tsed_pairs"]) == len(picture_gauges.ORBIT_YAWS) - 1
    assert result.extra["tsed_pairs"][0]["a"] == "-30/+5"
    assert result.notes[0] == "before" and any("--sfm" in note for note in result.notes)


def test_structure_from_motion_is_taken_over_or_its_reason_told(empty, monkeypatch):
    found = StructureFromMotion(13, 12, 200, 0.4, 0.3, 0.2)
    monkeypatch.setattr(picture_gauges, "run_colmap", lambda *a, **k: found)
    result = measure_orbit(empty, TexturedField(), 64, sfm=True)
    assert result.metric("sfm_registered").value == pytest.approx(12 / 13)
    assert result.metric("sfm_turn_deg").value == 0.2 and result.extra["structure_from_motion"]["points"] == 200
    monkeypatch.setattr(picture_gauges, "run_colmap", lambda *a, **k: StructureFromMotion(13, reason="no COLMAP"))
    result = measure_orbit(empty, TexturedField(), 64, sfm=True)
    assert any("no COLMAP" in note for note in result.notes)
    assert result.metric("sfm_registered").verdict == "unmeasured"
    monkeypatch.setattr(picture_gauges, "run_colmap", lambda *a, **k: StructureFromMotion(13, reason=NO_MODEL))
    assert measure_orbit(empty, TexturedField(), 64, sfm=True).metric("sfm_registered").value == 0.0


def test_the_error_bar_of_a_share_is_wilsons():
    # Newcombe 1998, table I: 81 of 263 has the 95 % interval 0.2553 to 0.3662
    assert share_interval(81 / 263, 263) == pytest.approx(0.5 * (0.3662 - 0.2553), abs=1e-4)
    assert 0.0 < share_interval(1.0, 18) < 0.1 and math.isnan(share_interval(math.nan, 0))
