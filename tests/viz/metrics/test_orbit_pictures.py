"""An orbit's pictures against their cameras, and the values they become."""

from __future__ import annotations

import math

import pytest

from gazenerf.viz.check.result import CheckResult
from gazenerf.viz.metrics import orbit_pictures
from gazenerf.viz.metrics.colmap import NO_MODEL, StructureFromMotion
from gazenerf.viz.metrics.error_bars import share_error
from gazenerf.viz.metrics.families import CHECK_DEFINITIONS, measured
from gazenerf.viz.metrics.orbit_pictures import ORBIT_YAWS, OrbitPictures, measure_orbit
from gazenerf.viz.metrics.readings import of_pictures
from tests.textured_double import TexturedField


def result_of(orbit: OrbitPictures) -> CheckResult:
    """A check that measured nothing else."""
    metrics = measured(CHECK_DEFINITIONS, of_pictures(orbit.tsed, orbit.motion, 0))
    return CheckResult(metrics, (), (), (), {}, orbit=orbit)


def test_an_exact_field_is_perfect():
    result = result_of(measure_orbit(TexturedField(), 128))
    assert result.metric("tsed_2px").value == 1.0 and result.metric("tsed_matches").value > 20.0
    assert result.metric("sfm_registered").verdict == "unmeasured" and math.isnan(
        result.metric("depth_median_mm").value
    )
    data = result.to_dict()
    assert len(data["tsed_pairs"]) == len(ORBIT_YAWS) - 1 and "structure_from_motion" not in data
    assert data["tsed_pairs"][0]["a"] == "-30/+5"


def test_structure_from_motion_is_taken_over_or_its_reason_kept(monkeypatch):
    found = StructureFromMotion(13, 12, 200, 0.4, 0.3, 0.2)
    monkeypatch.setattr(orbit_pictures, "run_colmap", lambda *a, **k: found)
    result = result_of(measure_orbit(TexturedField(), 64, sfm=True))
    assert result.metric("sfm_registered").value == pytest.approx(12 / 13)
    assert result.metric("sfm_turn_deg").value == 0.2 and result.to_dict()["structure_from_motion"]["points"] == 200
    monkeypatch.setattr(orbit_pictures, "run_colmap", lambda *a, **k: StructureFromMotion(13, reason="no COLMAP"))
    result = result_of(measure_orbit(TexturedField(), 64, sfm=True))
    assert result.orbit is not None and result.orbit.motion is not None and result.orbit.motion.reason == "no COLMAP"
    assert result.metric("sfm_registered").verdict == "unmeasured"
    monkeypatch.setattr(orbit_pictures, "run_colmap", lambda *a, **k: StructureFromMotion(13, reason=NO_MODEL))
    assert result_of(measure_orbit(TexturedField(), 64, sfm=True)).metric("sfm_registered").value == 0.0


def test_the_error_bar_of_a_share_is_wilsons():
    # Newcombe 1998, table I: 81 of 263 has the 95 % interval 0.2553 to 0.3662
    assert share_error(81 / 263, 263) == pytest.approx(0.5 * (0.3662 - 0.2553), abs=1e-4)
    assert 0.0 < share_error(1.0, 18) < 0.1 and math.isnan(share_error(math.nan, 0))
