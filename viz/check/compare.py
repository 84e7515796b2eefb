"""Two runs of `gazenerf check` side by side, differences judged against the error bars."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gazenerf.errors import UserError
from gazenerf.files import read_json, whole_file
from gazenerf.viz.metrics.definitions import Metric
from gazenerf.viz.report.page import counts, escape, number, page, pill, with_error

PAGE = "compare.html"
MAX_BYTES = 32 * 2**20
BETTER, WORSE, SAME, UNSURE, MISSING = "better", "worse", "same", "no error bar", "not in both"
COLOURS = {BETTER: "pass", WORSE: "fail", SAME: "unmeasured", UNSURE: "warn", MISSING: "unmeasured"}


@dataclass(frozen=True)
class Row:
    """One metric of two runs.

    Attributes:
        a, b: As reported.
        change: b less a, NaN when one is missing.
        bar: Half width of the 95 % interval of the change, from both error bars; NaN when one is unknown.
    """

    a: Metric
    b: Metric

    @property
    def change(self) -> float:
        return self.b.value - self.a.value

    @property
    def bar(self) -> float:
        return math.hypot(self.a.error, self.b.error)

    @property
    def judgement(self) -> str:
        """How b stands to a: better, worse, or same within the bars; unsure where a bar is unknown and they differ."""
        if not math.isfinite(self.change):
            return MISSING
        if self.change == 0.0:
            return SAME
        if not math.isfinite(self.bar):
            return UNSURE
        if abs(self.change) <= self.bar:
            return SAME
        return BETTER if (self.change > 0) == self.a.higher_is_better else WORSE


@dataclass(frozen=True)
class Comparison:
    """Two runs.

    Attributes:
        names: Of the two files.
        about: What each report says of its source.
        definitions: Version that both follow.
        rows: Metrics of either, in the order of the first.
        differences: Settings that differ between the runs, such as the size; they make a comparison unfair.
    """

    names: tuple[str, str]
    about: tuple[dict[str, Any], dict[str, Any]]
    definitions: str
    rows: tuple[Row, ...]
    differences: tuple[str, ...]


SETTINGS = (
    "size_px", "width_px", "height_px", "views", "frames", "gaze_pitch_yaw_degrees", "gaze_grid_degrees", "seed",
    "reference_mesh_sha256_16",
)  # fmt: skip
"""Keys of `about` that should agree between compared runs."""


def compare_reports(a: str | Path, b: str | Path) -> Comparison:
    """Read two report.json files.

    Raises:
        UserError: a file is no report, or they follow different versions of the definitions.
    """
    first, second = _read(Path(a)), _read(Path(b))
    if first["definitions"] != second["definitions"]:
        raise UserError(
            f"{a} follows {first['definitions']}, {b} follows {second['definitions']}: the numbers mean different "
            "things; measure one of them again"
        )
    mine, theirs = ({metric.name: metric for metric in _metrics(data)} for data in (first, second))
    rows = []
    for name in dict.fromkeys([*mine, *theirs]):
        present = mine.get(name) or theirs[name]
        absent = Metric(**{**vars(present), "value": math.nan, "error": math.nan})
        rows.append(Row(mine.get(name, absent), theirs.get(name, absent)))
    about = (first["about"], second["about"])
    differing = tuple(
        f"{key}: {about[0].get(key)} and {about[1].get(key)}"
        for key in SETTINGS
        if about[0].get(key) != about[1].get(key)
    )
    return Comparison((_name(Path(a)), _name(Path(b))), about, first["definitions"], tuple(rows), differing)


def _name(path: Path) -> str:
    """A file's path without what every report is called."""
    return str(path.parent if path.name == "report.json" and path.parent.name else path)


def _read(path: Path) -> dict[str, Any]:
    path = path / "report.json" if path.is_dir() else path
    wanted = "give a report.json of `gazenerf check`"
    data = read_json(path, MAX_BYTES, absent=wanted, large=wanted)
    good = isinstance(data, dict) and isinstance(data.get("definitions"), str) and isinstance(data.get("metrics"), list)
    if not good or not isinstance(data.get("about"), dict):
        raise UserError(f"{path} is no report.json of `gazenerf check`")
    return data | {"path": path}


def _metrics(data: dict[str, Any]) -> list[Metric]:
    found = []
    for entry in data["metrics"]:
        try:
            value, passes, warns, error, reference = (
                math.nan if entry.get(key) is None else float(entry[key])
                for key in ("value", "passes", "warns", "error", "reference")
            )
            name, label, unit, group = (str(entry.get(key, "")) for key in ("name", "label", "unit", "group"))
            higher = bool(entry["higher_is_better"])
            found.append(Metric(name, label, unit, value, passes, warns, higher, group, error, reference))
        except (AttributeError, KeyError, TypeError, ValueError, OverflowError) as error:
            raise UserError(
                f"{data['path']} holds a metric that cannot be read; was it written by another program?"
            ) from error
    return found


def terminal_rows(comparison: Comparison) -> list[tuple[str, str, str, str, str]]:
    """Label, both values, change, judgement of every metric that either run measured."""
    return [
        (row.a.label, _plain(row.a), _plain(row.b), change_text(row), row.judgement)
        for row in comparison.rows
        if math.isfinite(row.a.value) or math.isfinite(row.b.value)
    ]


def change_text(row: Row) -> str:
    """The change with its sign and error bar."""
    if not math.isfinite(row.change):
        return ""
    bar = f" ± {number(row.bar)}" if math.isfinite(row.bar) else ""
    return f"{'+' if row.change > 0 else ''}{number(row.change)}{bar}"


def _plain(metric: Metric) -> str:
    bar = f" ± {number(metric.error)}" if math.isfinite(metric.error) and math.isfinite(metric.value) else ""
    return f"{number(metric.value)}{bar} {metric.unit}".strip() if math.isfinite(metric.value) else "–"


def summary(comparison: Comparison) -> str:
    """How the second run stands to the first, in one line."""
    found = [row.judgement for row in comparison.rows]
    return ", ".join(f"{found.count(kind)} {kind}" for kind in COLOURS if kind in found)


def render_comparison(comparison: Comparison) -> str:
    """The comparison as a self-contained page."""
    groups = dict.fromkeys(row.a.group for row in comparison.rows)
    body = []
    for group in groups:
        rows = [row for row in comparison.rows if row.a.group == group and row.judgement != MISSING]
        if rows:
            body.append(f"<tr class=g><th colspan=5 scope=rowgroup>{escape(group)}</th></tr>")
            body += [_row(row) for row in rows]
    absent = [row.a.label for row in comparison.rows if row.judgement == MISSING]
    first, second = (escape(name) for name in comparison.names)
    unfair = "".join(f"<li>{escape(text)}</li>" for text in comparison.differences)
    sides = "".join(
        f"<h3>{name}: {escape(str(about.get('subject', '')))}</h3>"
        f"<p class=quiet>weights {escape(str(about.get('weights_sha256_16', 'unknown')))}</p>"
        f"{counts([metric(row) for row in comparison.rows])}"
        for name, about, metric in (
            (first, comparison.about[0], lambda row: row.a),
            (second, comparison.about[1], lambda row: row.b),
        )
    )
    return page(
        "Two checks compared",
        f"<h1>{second} against {first}</h1><p>{escape(summary(comparison))}.</p>"
        "<p class=quiet>Better, worse or same is the second against the first: same where they differ by less than the "
        "95 % interval of the difference.</p>"
        + (f"<p>The runs were not made alike, so the comparison may be unfair:</p><ul>{unfair}</ul>" if unfair else "")
        + f"<div class=scroll><table class=verdict><tr><th>measure</th><th class=n>{first}</th>"
        f"<th class=n>{second}</th><th class='n wide'>change</th><th>second is</th></tr>{''.join(body)}</table></div>"
        + (f"<p class=quiet>Not in both: {escape(', '.join(absent))}.</p>" if absent else "")
        + sides
        + f"<p class=quiet>Definitions {escape(comparison.definitions)}.</p>",
    )


def _row(row: Row) -> str:
    return (
        f"<tr><td>{escape(row.a.label)}<code>{escape(row.a.name)}</code></td><td class=n>{with_error(row.a)}</td>"
        f"<td class=n>{with_error(row.b)}</td><td class='n wide'>{escape(change_text(row))}</td>"
        f"<td>{pill(COLOURS[row.judgement], row.judgement)}</td></tr>"
    )


def write_comparison(comparison: Comparison, out: str | Path) -> Path:
    """Write the page: to `out` where it ends in .html, else to compare.html in the folder `out`."""
    path = Path(out) if Path(out).suffix == ".html" else Path(out) / PAGE
    with whole_file(path) as temporary:
        temporary.write_text(render_comparison(comparison), encoding="utf-8")
    return path
