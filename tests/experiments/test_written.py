"""Tables as text."""

from __future__ import annotations

import pytest

from gazenerf.experiments.tables import tables_of, with_interval
from gazenerf.experiments.written import escaped, latex, markdown


def estimate(mean: float, low: float | None = None, high: float | None = None) -> dict:
    return {"mean": mean, "low": low, "high": high, "subjects": 3, "method": "t"}


@pytest.fixture
def result() -> dict:
    measured = {
        "gaze_deg": estimate(8.123, 6.0, 10.25),
        "psnr": estimate(21.0),
        "gaze_label_deg": estimate(9.0, 7.0, 11.0),
    }
    paper = {"gaze_deg": 6.944, "fid": 81.816}
    return {
        "experiment": "within",
        "data": {"people": 9, "held_out": 3, "pixels": 64},
        "estimator": {"name": "small of 1234"},
        "trainings": {"gazenerf": {"steps": 100, "minutes": 5.5, "machines": [
            {"cpu": "Fast & Co", "cores": 2, "threads": "1", "gpu": None}]}},
        "paper": {"source": "a paper", "table": "Table 1", "label": "tab:comare_xgaze", "said": "",
                  "sets": {"ETH-XGaze": {"gazenerf": paper, "sted": paper}}},
        "sets": {"held-out": {
            "data": "captures", "people": 3, "pairs": {"measured": 6},
            "estimator_error": {"gaze_estimator_deg": estimate(5.0, 4.0, 6.0)},
            "rows": {"sted": {"title": "STED", "failed": "out of memory"},
                     "gazenerf": {"title": "GazeNeRF", "measurements": measured}},
        }},
        "failed": {"sted on held-out": "out of memory"},
    }  # fmt: skip


def test_the_papers_numbers_stand_below_ours_and_the_estimators_error_last(result: dict):
    [table] = tables_of(result)
    names = [row.cells[0] for row in table.rows]
    assert names == ["STED", "paper, ETH-XGaze: STED", "GazeNeRF", "paper, ETH-XGaze: GazeNeRF",
                     "the estimator's own error"]  # fmt: skip
    gaze = [row.cells[1] for row in table.rows]
    assert gaze == ["failed: out of memory", "6.944", "8.12 (6 to 10.2)", "6.944", "-"]
    assert [row.cells[-1] for row in table.rows] == ["-", "-", "9 (7 to 11)", "-", "5 (4 to 6)"]
    assert not any("FID" in heading for heading in table.headings), "nobody measured it here"
    assert [row.published for row in table.rows] == [False, True, False, True, True]


def test_a_number_without_an_interval_is_shown_alone():
    assert with_interval(estimate(21.0)) == "21" and with_interval(None) == "-"


def test_markdown_says_what_can_be_compared_and_what_is_missing(result: dict):
    text = markdown(result)
    assert "| *paper, ETH-XGaze: GazeNeRF* | *6.944* |" in text
    assert "cannot be compared with ours" in text and "Missing: sted on held-out: out of memory" in text
    assert "| gazenerf | 100 | 5.5 | Fast & Co, 2 cores, 1 thread(s) |" in text


def test_latex_is_escaped_and_balanced(result: dict):
    assert escaped("50 % of a_b & c ↓") == r"50 \% of a\_b \& c $\downarrow$"
    text = latex(result)
    below = r"GazeNeRF & \begin{tabular}[t]{@{}c@{}}8.12\\[-3pt]{\scriptsize 6 to 10.2}\end{tabular} &"
    assert r"\toprule" in text and below in text
    assert r"STED & \multicolumn{7}{l}{failed} \\" in text, "why it failed stands in the caption, not in a column"
    assert r"\resizebox{\ifdim\width>\linewidth\linewidth\else\width\fi}{!}{%" in text, "no wider than the text"
    assert text.count(r"\begin{") == text.count(r"\end{") and "tab:comare\\_xgaze" in text
    rows = [line for line in text.splitlines() if line.endswith(r"\\") and "failed" not in line]
    assert len({line.replace(r"\&", "").count("&") for line in rows}) == 1
    assert text.count("{") == text.count("}")


def test_latex_has_minus_signs_and_powers(result: dict):
    result["sets"]["held-out"]["rows"]["gazenerf"]["measurements"]["gaze_deg"] = estimate(8.75e-5, -1.5, 2.0)
    text = latex(result)
    assert r"8.75$\cdot10^{-5}$\\[-3pt]{\scriptsize $-$1.5 to 2}" in text
    assert escaped("a < b | c > d") == r"a \textless{} b \textbar{} c \textgreater{} d"
