"""Two reports side by side: what counts as better, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from gazenerf.errors import UserError
from gazenerf.viz.check.compare import (
    BETTER,
    MISSING,
    SAME,
    UNSURE,
    WORSE,
    compare_reports,
)
from gazenerf.viz.metrics.families import CHECK_DEFINITIONS, measured


def report(folder: Path, values: dict[str, tuple[float | None, float | None]], **changes: Any) -> Path:
    """A report.json with some metrics' (value, error)."""
    metrics = []
    for metric in measured(CHECK_DEFINITIONS):
        value, error = values.get(metric.name, (None, None))
        metrics.append({**metric.to_dict(), "value": value, "error": error, "reference": None})
    about = {"subject": "<i>ada</i>", "size_px": 256, "weights_sha256_16": "w1"} | changes.pop("about", {})
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "report.json"
    path.write_text(json.dumps({"definitions": "v1", "about": about, "metrics": metrics} | changes))
    return path


FIRST = {
    "depth_median_mm": (1.0, 0.1), "silhouette_iou": (0.95, 0.001), "chamfer_mm": (1.0, 0.3),
    "f_score_1mm": (0.5, None), "scale_percent": (0.2, None), "warp_psnr": (30.0, 1.0), "frame_turn_deg": (0.1, None),
}  # fmt: skip
SECOND = {
    "depth_median_mm": (1.3, 0.1), "silhouette_iou": (0.97, 0.001), "chamfer_mm": (1.3, 0.3),
    "f_score_1mm": (0.6, None), "scale_percent": (0.2, None), "frame_turn_deg": (None, None),
}  # fmt: skip


def test_changes_are_judged_by_their_error_bars_and_direction(tmp_path):
    found = compare_reports(report(tmp_path / "a", FIRST), report(tmp_path / "b", SECOND))
    judged = {row.a.name: row.judgement for row in found.rows}
    assert judged["depth_median_mm"] == WORSE, "higher, beyond hypot(0.1, 0.1)"
    assert judged["silhouette_iou"] == BETTER and judged["chamfer_mm"] == SAME
    assert judged["f_score_1mm"] == UNSURE and judged["scale_percent"] == SAME
    assert judged["warp_psnr"] == judged["frame_turn_deg"] == judged["normal_median_deg"] == MISSING


def test_other_definitions_and_files_that_are_no_reports_are_refused(tmp_path):
    good = report(tmp_path / "a", FIRST)
    with pytest.raises(UserError, match=r"follows v1, .* follows v2: .*measure one of them again"):
        compare_reports(good, report(tmp_path / "b", SECOND, definitions="v2"))
    with pytest.raises(UserError, match="does not exist"):
        compare_reports(good, tmp_path / "none.json")
    for text, message in (
        ("{", "cannot be read as JSON"),
        ("[]", "is no report.json"),
        ('{"definitions": "v1", "about": {}}', "is no report.json"),
        ('{"definitions": "v1", "about": {}, "metrics": [3]}', "metric that cannot be read"),
        ('{"definitions": "v1", "about": {}, "metrics": [{"name": "x"}]}', "metric that cannot be read"),
        ('{"definitions": "v1", "about": {}, "metrics": [{"higher_is_better": 1, "value": "x"}]}', "cannot be read"),
    ):
        bad = tmp_path / "bad.json"
        bad.write_text(text)
        with pytest.raises(UserError, match=message):
            compare_reports(good, bad)
