"""Faults of known size: each must move its own gauge beyond its limit, by its size, and no other fault's."""

from __future__ import annotations

import pytest

from viz.check import GAUGES, Metric
from viz.faults import FAULTS, FINDINGS, findings, read_gauges, table
from viz.reference import RENDERERS, usable

SIZE = 96

FRAME = {"frame_shift_mm", "frame_turn_deg", "scale_percent"}
VIEWS = {"reprojection", "round_trip_px", "warp_psnr", "warp_worst_psnr"}

EXPECTED: dict[str, tuple[dict[str, tuple[float, float]], set[str]]] = {
    "none": ({"chamfer_mm": (0.0, 0.1), "frame_shift_mm": (0.0, 0.05), "eye_centre_mm": (0.0, 0.05)}, set(FINDINGS)),
    "reference moved 2.0 mm to the left": (
        {"frame_shift_mm": (2.0, 0.1), "chamfer_aligned_mm": (0.0, 0.1), "eye_centre_mm": (2.0, 0.2)},
        {"frame_turn_deg", "scale_percent", "chamfer_aligned_mm"} | VIEWS,
    ),
    "reference moved 2.0 mm forward": (
        {"frame_shift_mm": (2.0, 0.1), "chamfer_aligned_mm": (0.0, 0.1), "eye_centre_mm": (2.0, 0.2)},
        {"frame_turn_deg", "scale_percent", "chamfer_aligned_mm"} | VIEWS,
    ),
    "reference 2 % larger": (
        {"scale_percent": (2.0, 0.3), "frame_shift_mm": (0.0, 0.1)},
        {"frame_shift_mm", "frame_turn_deg"} | VIEWS,
    ),
    "cameras off by 0.5 degrees of yaw": (
        {"frame_turn_deg": (0.5, 0.1), "frame_shift_mm": (0.0, 0.1)},
        {"frame_shift_mm", "scale_percent", "chamfer_aligned_mm"} | VIEWS,
    ),
    "left eye moved by 1.0 mm": ({"eye_centre_mm": (1.0, 0.2)}, FRAME | VIEWS | {"depth_median_mm"}),
    "floater 10 mm before the cheek": ({"blemish_mm2": (314.0, 60.0)}, FRAME | {"depth_median_mm", "eye_centre_mm"}),
    "hole in the cheek": ({"blemish_mm2": (314.0, 60.0)}, FRAME | VIEWS | {"depth_median_mm", "eye_centre_mm"}),
    "noise of 2.0 mm on depth": ({"depth_median_mm": (0.6745 * 2.0, 0.1)}, {"normal_median_deg", "blemish_mm2"}),
    "pattern glued to the screen": ({}, set(FINDINGS) - {"warp_psnr", "warp_worst_psnr"}),
    "picture of one view swapped": ({}, set(FINDINGS) - {"warp_worst_psnr"}),
}
"""Fault to what its gauges read, as (value, tolerance), and the gauges that must stay within their limits.

The floater and the hole are a disc of 10 mm radius, 314 mm², on the cheek. The median of an absolute
normal deviation is 0.6745 of its standard deviation."""

OWN = {
    "reference moved 2.0 mm to the left": {"frame_shift_mm", "depth_median_mm", "silhouette_iou", "chamfer_mm"},
    "reference moved 2.0 mm forward": {"frame_shift_mm", "depth_median_mm", "silhouette_iou", "chamfer_mm"},
    "reference 2 % larger": {"scale_percent", "silhouette_iou", "chamfer_mm", "chamfer_aligned_mm"},
    "cameras off by 0.5 degrees of yaw": {"frame_turn_deg"},
    "left eye moved by 1.0 mm": {"eye_centre_mm"},
    "floater 10 mm before the cheek": {"blemish_mm2"},
    "hole in the cheek": {"blemish_mm2", "silhouette_iou"},
    "noise of 2.0 mm on depth": {"depth_median_mm", "chamfer_aligned_mm", "reprojection", "round_trip_px"},
    "pattern glued to the screen": {"warp_psnr", "warp_worst_psnr"},
    "picture of one view swapped": {"warp_worst_psnr"},
}
"""Fault to the gauges that must find it."""


@pytest.fixture(scope="module")
def readings() -> dict[str, dict[str, Metric]]:
    if not any(usable(name) for name in RENDERERS):
        pytest.skip("no reference renderer starts here: needs mitsuba, EGL or open3d's libraries")
    return {name: read_gauges(*fault(0), size=SIZE) for name, fault in FAULTS.items()}


def test_every_fault_is_expected_to_be_found():
    assert set(EXPECTED) == set(FAULTS) and set(OWN) == set(FAULTS) - {"none"}
    assert set(FINDINGS) <= {gauge.name for gauge in GAUGES}


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_is_found_at_its_size_and_only_where_it_is(readings, name):
    sizes, quiet = EXPECTED[name]
    for gauge, (size, tolerance) in sizes.items():
        assert readings[name][gauge].value == pytest.approx(size, abs=tolerance), gauge
    found = findings(readings[name])
    assert OWN.get(name, set()) <= found
    assert not found & quiet


def test_every_gauge_finds_some_fault(readings):
    assert set().union(*(findings(metrics) for metrics in readings.values())) == set(FINDINGS)


def test_the_table_marks_findings(monkeypatch):
    read = {
        name: Metric(name, name, "", 0.0 if not better else 99.0, 0.0, 0.0, better)
        for name, better in ((gauge.name, gauge.higher_is_better) for gauge in GAUGES)
        if name in FINDINGS
    }
    bad = read | {"frame_turn_deg": Metric("frame_turn_deg", "", "deg", 0.5, 0.0, 0.0)}
    monkeypatch.setattr("viz.faults.FAULTS", {"none": lambda seed: (False,) * 2, "turned": lambda seed: (True,) * 2})
    monkeypatch.setattr("viz.faults.read_gauges", lambda field, mesh, size: bad if field else read)
    lines = table().splitlines()
    assert len(lines) == 2 + len(FINDINGS)
    assert "| `frame_turn_deg` | > 0.25 | 0.00 | **0.50** |" in lines
    assert sum("**" in line for line in lines) == 1
