"""What is said of metrics, and that the docs say the same."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest

from gazenerf.errors import UserError
from gazenerf.viz.metrics.definitions import check_names
from gazenerf.viz.metrics.families import ALL, CHECK_DEFINITIONS, FAULT_DEFINITIONS, FRAMES_DEFINITIONS, measured

ROOT = Path(__file__).parents[3]
spec = importlib.util.spec_from_file_location("build_metric_tables", ROOT / "scripts" / "build_metric_tables.py")
assert spec is not None and spec.loader is not None
build_metric_tables = importlib.util.module_from_spec(spec)
spec.loader.exec_module(build_metric_tables)


@pytest.mark.parametrize("definition", ALL, ids=lambda one: f"{one.checks[0]}:{one.name}")
def test_every_definition_is_complete(definition):
    for sentence in (definition.meaning, definition.advice, definition.method):
        assert sentence[0].isupper() and sentence.endswith("."), sentence
    assert definition.meaning.count(". ") == 0 and definition.advice.count(". ") <= 1
    assert definition.group and definition.label and definition.checks
    low, high = definition.bounds
    assert low < high and low <= definition.passes <= high and low <= definition.warns <= high
    sign = -1.0 if definition.higher_is_better else 1.0
    assert sign * definition.passes < sign * definition.warns, "what warns is worse than what passes"


def test_names_are_one_each_in_a_check_and_every_definition_belongs_to_one():
    for definitions in (CHECK_DEFINITIONS, FRAMES_DEFINITIONS):
        names = [one.name for one in definitions]
        assert len(names) == len(set(names)) > 10
    assert set(ALL) == set(CHECK_DEFINITIONS) | set(FRAMES_DEFINITIONS)
    assert set(FAULT_DEFINITIONS) < set(CHECK_DEFINITIONS)
    with pytest.raises(UserError, match="unknown metric 'beauty'"):
        check_names(["beauty"], CHECK_DEFINITIONS)


def test_report_json_keeps_its_keys():
    entry = measured(CHECK_DEFINITIONS, {"depth_median_mm": (2.0, 0.5)}, {"depth_median_mm": 0.1})[0].to_dict()
    assert list(entry) == [
        "name", "label", "unit", "value", "passes", "warns", "higher_is_better", "group", "error", "reference",
        "meaning", "verdict",
    ]  # fmt: skip
    assert (entry["value"], entry["error"], entry["reference"], entry["verdict"]) == (2.0, 0.5, 0.1, "warn")


@pytest.mark.parametrize("name", build_metric_tables.PAGES)
def test_the_docs_say_what_the_definitions_say(name):
    text = (ROOT / "docs" / name).read_text(encoding="utf-8")
    made = build_metric_tables.filled(text, build_metric_tables.PAGES[name])
    assert made == text, "run python scripts/build_metric_tables.py"


def test_the_matrix_of_faults_has_a_row_per_metric_with_its_limit():
    text = (ROOT / "docs" / "consistency.md").read_text(encoding="utf-8")
    matrix = next(old for _, group, old, _ in build_metric_tables.MARKED.findall(text) if "faults" in group)
    rows = [line.split(" | ")[:2] for line in matrix.strip().splitlines()[2:]]
    wanted = []
    for one in FAULT_DEFINITIONS:
        assert one.finding is not None
        wanted.append([f"| `{one.name}`", f"{'<' if one.higher_is_better else '>'} {one.finding.limit:g}"])
    assert rows == wanted, "run python scripts/build_metric_tables.py --faults"
