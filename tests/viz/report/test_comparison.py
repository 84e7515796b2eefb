"""Two reports side by side: rows for a terminal, the answer and the page."""

from __future__ import annotations

import html
import re
from pathlib import Path

from gazenerf.viz.check.compare import WORSE, Comparison, compare_reports
from gazenerf.viz.report.comparison import PAGE, answer, summary, terminal_rows, write_comparison
from tests.viz.check.test_compare import FIRST, SECOND, report


def compared(folder: Path, first: dict, second: dict) -> Comparison:
    """Reports of two sets of (value, error) compared."""
    return compare_reports(report(folder / "a", first), report(folder / "b", second))


def test_changes_are_listed_with_their_error_bars(tmp_path):
    found = compared(tmp_path, FIRST, SECOND)
    assert summary(found).startswith("1 better, 1 worse, 2 same, 1 no error bar")
    rows = {row[0]: row[1:] for row in terminal_rows(found)}
    assert rows["depth error, median"] == ("1.000 ± 0.100 mm", "1.300 ± 0.100 mm", "+0.300 ± 0.141", WORSE)
    assert rows["frame turn"][1] == "–" and "normal error, median" not in rows


def test_the_answer_is_one_sentence_that_counts(tmp_path):
    mixed = answer(compared(tmp_path / "mixed", FIRST, SECOND))
    assert mixed == (
        "It depends: compared with the first, the second is better in 1 and worse in 1 of the 5 metrics measured in "
        "both, and 1 metric changed by an amount that no error bar judges."
    )
    name = "depth_median_mm"
    better = answer(compared(tmp_path / "better", {name: (1.0, 0.1)}, {name: (0.5, 0.1)}))
    assert better.startswith("Yes: ") and "better in 1 and worse in none of the 1 metric" in better
    worse = answer(compared(tmp_path / "worse", {name: (0.5, 0.1)}, {name: (1.0, 0.1)}))
    assert worse.startswith("No: ") and "worse in 1" in worse
    same = answer(compared(tmp_path / "same", {name: (0.5, 0.1)}, {name: (0.55, 0.1)}))
    assert same.startswith("No difference shows")
    assert answer(compared(tmp_path / "none", {}, {})).startswith("Nobody can tell")


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


def test_every_compared_metric_has_its_meaning_and_families_that_changed_are_open(tmp_path):
    found = compared(tmp_path, FIRST, SECOND)
    text = write_comparison(found, tmp_path / "out").read_text()
    said = html.unescape(text)
    both = [row.a.definition for row in found.rows if row.judgement != "not in both"]
    assert len(both) == 5 and all(definition.meaning and definition.meaning in said for definition in both)
    opened = re.findall(r'<details class="family" open>\s*<summary><span class="name">([^<]+)<', text)
    assert {html.unescape(name) for name in opened} == {
        row.a.definition.group for row in found.rows if row.judgement in ("better", "worse", "no error bar")
    }
