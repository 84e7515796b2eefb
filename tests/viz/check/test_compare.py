"""Two reports side by side: what counts as better, and what is refused."""

from __future__ import annotations

import json
import re
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import pytest

from gazenerf.errors import UserError
from gazenerf.viz.check.compare import (
    BETTER,
    MISSING,
    PAGE,
    SAME,
    UNSURE,
    WORSE,
    compare_reports,
    summary,
    terminal_rows,
    write_comparison,
)
from gazenerf.viz.metrics.definitions import GAUGES


def report(folder: Path, values: dict[str, tuple[float | None, float | None]], **changes: Any) -> Path:
    """A report.json with some metrics' (value, error)."""
    metrics = []
    for gauge in GAUGES:
        value, error = values.get(gauge.name, (None, None))
        metrics.append({**asdict(replace(gauge)), "value": value, "error": error, "reference": None})
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
    assert summary(found).startswith("1 better, 1 worse, 2 same, 1 no error bar")
    rows = {row[0]: row[1:] for row in terminal_rows(found)}
    assert rows["depth error, median"] == ("1.000 ± 0.100 mm", "1.300 ± 0.100 mm", "+0.300 ± 0.141", WORSE)
    assert rows["frame turn"][1] == "–" and "normal error, median" not in rows


def test_the_page_is_whole_and_names_unfair_settings(tmp_path):
    b = report(tmp_path / "b", SECOND, about={"size_px": 128})
    found = compare_reports(report(tmp_path / "a", FIRST).parent, b)
    assert found.differences == ("size_px: 256 and 128",)
    page = write_comparison(found, tmp_path / "out")
    text = page.read_text()
    assert page == tmp_path / "out" / PAGE and "size_px: 256 and 128" in text
    assert "&lt;i&gt;ada" in text and not re.search(r"<i>ada|https?:", text)
    assert text.count(">worse</span>") == 1 and text.count(">better</span>") == 1
    assert write_comparison(found, tmp_path / "other.html") == tmp_path / "other.html"


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
