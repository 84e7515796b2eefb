"""Two reports of `gazenerf check` side by side, differences judged against the error bars."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from gazenerf.errors import UserError
from gazenerf.files import read_json
from gazenerf.viz.metrics.definitions import ANY, Definition, Metric
from gazenerf.viz.metrics.families import FRAMES_VERSION, of_check

MAX_BYTES = 32 * 2**20
BETTER, WORSE, SAME, UNSURE, MISSING = "better", "worse", "same", "no error bar", "not in both"


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
        return BETTER if (self.change > 0) == self.a.definition.higher_is_better else WORSE


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
        absent = replace(present, value=math.nan, error=math.nan)
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
    known = {one.name: one for one in of_check("frames" if data["definitions"] == FRAMES_VERSION else "field")}
    try:
        return [_metric(entry, known.get(str(entry["name"]))) for entry in data["metrics"]]
    except (AttributeError, KeyError, TypeError, ValueError, OverflowError) as error:
        raise UserError(
            f"{data['path']} holds a metric that cannot be read; was it written by another program?"
        ) from error


def _metric(entry: dict[str, Any], known: Definition | None) -> Metric:
    """A metric as a report holds it; bounds, and a meaning that it lacks, are those of the definition known here."""
    value, passes, warns, error, reference = (
        math.nan if entry.get(key) is None else float(entry[key])
        for key in ("value", "passes", "warns", "error", "reference")
    )
    name, label, unit, group, meaning = (
        str(entry.get(key, "")) for key in ("name", "label", "unit", "group", "meaning")
    )
    definition = Definition(
        name,
        label,
        unit,
        meaning or (known.meaning if known else ""),
        passes=passes,
        warns=warns,
        higher_is_better=bool(entry["higher_is_better"]),
        group=group,
        bounds=known.bounds if known else ANY,
    )
    return Metric(definition, value, error, reference)
