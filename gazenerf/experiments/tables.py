"""The result of an experiment as tables: ours with intervals, and beside each row the paper's printed numbers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from gazenerf.evaluation.intervals import SHARE

COLUMNS = {
    "gaze_deg": "Gaze, deg ↓",
    "head_deg": "Head pose, deg ↓",
    "ssim": "SSIM ↑",
    "psnr": "PSNR, dB ↑",
    "lpips": "LPIPS ↓",
    "fid": "FID ↓",
    "frechet_alexnet": "Frechet (AlexNet) ↓",
    "identity_similarity": "Identity ↑",
    "gaze_label_deg": "Gaze against label, deg ↓",
}
"""Measurement to heading; arrows say which way is better. The last one is not in the paper."""

OPTIONAL = ("fid", "frechet_alexnet")
"""Left out where no row has them."""

NONE = "-"
FAILED = "failed: "
PAPER = "paper"
"""How names of rows begin whose numbers the paper prints."""


@dataclass(frozen=True)
class TableRow:
    """A row of a table.

    Attributes:
        cells: Texts, the row's name first.
        published: Of the paper, or of what is no model; shown fainter.
    """

    cells: tuple[str, ...]
    published: bool = False


@dataclass(frozen=True)
class ResultTable:
    """A table.

    Attributes:
        title: What it shows.
        headings: Of its columns.
        rows: From the top.
    """

    title: str
    headings: tuple[str, ...]
    rows: tuple[TableRow, ...]


def tables_of(result: Mapping[str, Any]) -> list[ResultTable]:
    """The tables of a result as `NAME.json` holds it."""
    return _calibration_tables(result) if result["experiment"] == "calibration" else _row_tables(result)


def _row_tables(result: Mapping[str, Any]) -> list[ResultTable]:
    paper, sets = result["paper"], result["sets"]
    columns = _columns(row for found in sets.values() for row in found["rows"].values())
    beside = paper["sets"] if result["experiment"] != "cross" else {}
    made = []
    for name, found in sets.items():
        rows: list[TableRow] = []
        for row, about in found["rows"].items():
            rows.append(_own(about, columns))
            for where, numbers in beside.items():
                title = f"{PAPER}, {where}: {about['title']}"
                rows.append(TableRow((title, *(_printed(numbers[row], column) for column in columns)), True))
        rows += _estimator_row(found["estimator_error"], columns)
        title = f"{result['experiment']}: {_pairs(found)} of {found['people']} people, {name}"
        made.append(ResultTable(title, ("model", *(COLUMNS[column] for column in columns)), tuple(rows)))
        made += _differences(name, found)
    if result["experiment"] == "cross":
        made += [_paper_table(where, numbers, result) for where, numbers in paper["sets"].items()]
    return made


def _differences(name: str, found: Mapping[str, Any]) -> list[ResultTable]:
    """How the rows of a set differ from its last one."""
    differences = found.get("differences")
    if not differences:
        return []
    titles = {row: about["title"] for row, about in found["rows"].items()}
    known = {column for values in differences["rows"].values() for column in values}
    columns = tuple(column for column in COLUMNS if column in known)
    rows = tuple(
        TableRow((titles[row], *(with_interval(values.get(column)) for column in columns)))
        for row, values in differences["rows"].items()
    )
    title = f"difference from {titles[differences['from']]}, person by person, {name}"
    return [ResultTable(title, ("model", *(COLUMNS[column] for column in columns)), rows)]


def _pairs(found: Mapping[str, Any]) -> str:
    pairs = found["pairs"]
    return "no redirections" if pairs is None else f"{pairs['measured']} redirections"


def _columns(rows: Iterable[Mapping[str, Any]]) -> tuple[str, ...]:
    measured = {name for row in rows for name in row.get("measurements", {})}
    return tuple(name for name in COLUMNS if name not in OPTIONAL or name in measured)


def _own(about: Mapping[str, Any], columns: Iterable[str]) -> TableRow:
    if "failed" in about:
        return TableRow((about["title"], f"{FAILED}{about['failed']}", *(NONE for _ in list(columns)[1:])))
    cells = (with_interval(about["measurements"].get(column)) for column in columns)
    return TableRow((about["title"], *cells))


def with_interval(estimate: Mapping[str, Any] | None) -> str:
    """A mean with its interval, three digits each."""
    if estimate is None:
        return NONE
    mean = f"{estimate['mean']:.3g}"
    if estimate["low"] is None or estimate["high"] is None:
        return mean
    return f"{mean} ({estimate['low']:.3g} to {estimate['high']:.3g})"


def _printed(numbers: Mapping[str, float], column: str) -> str:
    return f"{numbers[column]:.3f}" if column in numbers else NONE


def _estimator_row(errors: Mapping[str, Any], columns: tuple[str, ...]) -> list[TableRow]:
    if not errors:
        return []
    of = {"gaze_label_deg": "gaze_estimator_deg", "head_deg": "head_estimator_deg"}
    cells = (with_interval(errors.get(of.get(column, ""))) for column in columns)
    return [TableRow(("the estimator's own error", *cells), True)]


def _paper_table(where: str, numbers: Mapping[str, Any], result: Mapping[str, Any]) -> ResultTable:
    titles = {row: about["title"] for found in result["sets"].values() for row, about in found["rows"].items()}
    shown = [row for row in numbers if row in titles]
    columns = tuple(column for column in COLUMNS if column in numbers[shown[0]])
    rows = tuple(
        TableRow((f"{PAPER}: {titles[row]}", *(_printed(numbers[row], column) for column in columns)), True)
        for row in shown
    )
    return ResultTable(f"the paper on {where}", ("model", *(COLUMNS[column] for column in columns)), rows)


def _calibration_tables(result: Mapping[str, Any]) -> list[ResultTable]:
    real = [str(number) for number in result["real"]]
    headings = ("real pictures", *real)
    people = result["set"]["people"]
    errors = tuple(
        TableRow((about["title"], *(with_interval(about["errors"].get(number)) for number in real)))
        for about in result["methods"].values()
    )
    before = TableRow(("no calibration", with_interval(result["before"]), *(NONE for _ in real[1:])), True)
    gains = tuple(
        TableRow((about["title"], *(with_interval(about["gains"].get(number)) for number in real)))
        for about in result["methods"].values()
        if "gains" in about
    )
    made = [ResultTable(f"gaze error of {people} people, deg ↓", headings, (before, *errors))]
    if gains:
        made.append(ResultTable("gain over the real pictures alone, deg ↑", headings, gains))
    return made


def notes_of(result: Mapping[str, Any]) -> list[str]:
    """What has to be known to read the tables, in sentences."""
    paper, data = result["paper"], result["data"]
    said = [
        f"{data['people']} people, {data['held_out']} of them held out, pictures of {data['pixels']} px; estimator "
        f"{result['estimator']['name']}. With means intervals of {SHARE:.0%}: what other people might have given.",
        f"Rows marked paper are printed in its {paper['table']} ({paper['label']}; {paper['source']}). They are of "
        "other people, photographs, an estimator and networks of their own, and cannot be compared with ours; what can "
        "be is which row is better. The paper prints identity similarities in hundredths.",
    ]
    if result["experiment"] == "calibration":
        said[1] = f"The paper ({paper['label']}): {paper['said']}"
        said.append(
            f"{result['samples']} pictures in all where redirected ones are added; {result['steps']} steps of the "
            "estimator in every case. The curve of the real pictures alone has those alone."
        )
    elif any(about["estimator_error"] for about in result["sets"].values()):
        said.append(
            "Gaze and head pose are what the estimator reads off the redirected picture against what it reads off the "
            "true one, as in the paper; an estimator that sees little finds little difference. The last column is "
            "against the label, and in the last row stands what the estimator errs by on the true pictures: "
            "differences that are smaller say little. Differences between rows are means over people of each person's; "
            "an interval without zero is one that other people would hardly turn round."
        )
    if any("frechet_alexnet" in row.get("measurements", {}) for row in _all_rows(result)):
        said.append("The Frechet distance is of AlexNet's features, no FID, which needs Inception's weights.")
    return said + [f"Missing: {name}: {why}" for name, why in result["failed"].items()]


def _all_rows(result: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    return [row for found in result.get("sets", {}).values() for row in found["rows"].values()]


def costs_table(result: Mapping[str, Any]) -> ResultTable:
    """Steps and minutes of every training, and where it ran."""
    rows = []
    for name, about in result["trainings"].items():
        places = ", ".join(_place(machine) for machine in about.get("machines", []))
        rows.append(TableRow((name, str(about.get("steps", NONE)), str(about.get("minutes", NONE)), places or NONE)))
    return ResultTable("trainings", ("training", "steps", "minutes", "machine"), tuple(rows))


def _place(machine: Mapping[str, Any]) -> str:
    threads = f", {machine['threads']} thread(s)" if machine.get("threads") else ""
    return str(machine["gpu"] or f"{machine['cpu']}, {machine['cores']} cores{threads}")
