"""Two checks side by side, for a terminal and as a page."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from gazenerf.files import whole_file
from gazenerf.viz.check.compare import BETTER, MISSING, SAME, UNSURE, WORSE, Comparison, Row
from gazenerf.viz.metrics.definitions import Metric
from gazenerf.viz.report.blocks import (
    Block,
    ChangeFamily,
    ChangeRow,
    Changes,
    Group,
    Items,
    Page,
    Pill,
    Pills,
    Section,
    Text,
)
from gazenerf.viz.report.page import render
from gazenerf.viz.report.readable import number
from gazenerf.viz.report.verdict import counts, interval

PAGE = "compare.html"
TONES = {WORSE: "fail", BETTER: "pass", UNSURE: "warn", SAME: "unmeasured", MISSING: "unmeasured"}
"""Judgement to the colour of its pill, most telling first."""


def terminal_rows(comparison: Comparison) -> list[tuple[str, str, str, str, str]]:
    """Label, both values, change, judgement of every metric that either run measured."""
    return [
        (row.a.definition.label, _reading(row.a), _reading(row.b), change_text(row), row.judgement)
        for row in comparison.rows
        if math.isfinite(row.a.value) or math.isfinite(row.b.value)
    ]


def change_text(row: Row) -> str:
    """The change with its sign and error bar; empty when one run did not measure it."""
    if not math.isfinite(row.change):
        return ""
    bar = f" ± {number(row.bar)}" if math.isfinite(row.bar) else ""
    return f"{'+' if row.change > 0 else ''}{number(row.change)}{bar}"


def summary(comparison: Comparison) -> str:
    """How the second run stands to the first, as counts."""
    found = [row.judgement for row in comparison.rows]
    kinds = (BETTER, WORSE, SAME, UNSURE, MISSING)
    return ", ".join(f"{found.count(kind)} {kind}" for kind in kinds if kind in found)


def answer(comparison: Comparison) -> str:
    """Whether the second run is better than the first, in one sentence."""
    found = [row.judgement for row in comparison.rows]
    better, worse, unsure = (found.count(kind) for kind in (BETTER, WORSE, UNSURE))
    both = sum(kind != MISSING for kind in found)
    if not both:
        return "Nobody can tell, because no metric was measured in both checks."
    tail = f" of the {_of(both)} measured in both"
    if unsure:
        tail += f", and {_of(unsure)} changed by an amount that no error bar judges"
    if better and worse:
        return f"It depends: compared with the first, the second is better in {better} and worse in {worse}{tail}."
    if better:
        return f"Yes: compared with the first, the second is better in {better} and worse in none{tail}."
    if worse:
        return f"No: compared with the first, the second is worse in {worse} and better in none{tail}."
    return f"No difference shows: the second is neither better nor worse than the first in any{tail}."


def comparison_page(comparison: Comparison) -> Page:
    """The comparison as a page."""
    first, second = comparison.names
    absent = [row.a.definition.label for row in comparison.rows if row.judgement == MISSING]
    explained = Text(
        "Better, worse or same tells how the second stands to the first: same where the two differ by less than the "
        "95 % interval of their difference. Where an error bar is unknown the change is shown and not judged."
    )
    sections = [Section("Every metric of both", (explained, Changes(_families(comparison))))]
    if absent:
        sections.append(Section("Not in both", (Items(tuple(absent)),)))
    sections.append(
        Section(
            "The two checks",
            tuple(
                Group(
                    name,
                    (
                        _source(about),
                        counts([row.a if i == 0 else row.b for row in comparison.rows]),
                    ),
                )
                for i, (name, about) in enumerate(zip(comparison.names, comparison.about, strict=True))
            ),
        )
    )
    sections.append(Section("Provenance", (Text(f"Definitions {comparison.definitions}."),)))
    return Page(
        title="Two checks compared",
        question=f"Is {second} better than {first}?",
        about=f"First: {first}. Second: {second}.",
        answer=answer(comparison),
        tone=_tone({row.judgement for row in comparison.rows}),
        opening=(_pills([row.judgement for row in comparison.rows]), *_unfair(comparison)),
        sections=tuple(sections),
    )


def write_comparison(comparison: Comparison, out: str | Path) -> Path:
    """Write the page: to `out` where it ends in .html, else to compare.html in the folder `out`."""
    path = Path(out) if Path(out).suffix == ".html" else Path(out) / PAGE
    with whole_file(path) as temporary:
        temporary.write_text(render(comparison_page(comparison)), encoding="utf-8")
    return path


def _source(about: dict[str, Any]) -> Text:
    return Text(f"Subject {about.get('subject', '')}, weights {about.get('weights_sha256_16', 'unknown')}.")


def _tone(judgements: set[str]) -> str:
    if {BETTER, WORSE} <= judgements:
        return "warn"
    return "fail" if WORSE in judgements else "pass" if BETTER in judgements else "unmeasured"


def _of(count: int) -> str:
    return f"{count} metric" if count == 1 else f"{count} metrics"


def _unfair(comparison: Comparison) -> tuple[Block, ...]:
    if not comparison.differences:
        return ()
    return (
        Text("The two checks were not made with the same settings, so the comparison may be unfair:", quiet=False),
        Items(comparison.differences),
    )


def _families(comparison: Comparison) -> tuple[ChangeFamily, ...]:
    groups = dict.fromkeys(row.a.definition.group for row in comparison.rows)
    families = []
    for group in groups:
        rows = [row for row in comparison.rows if row.a.definition.group == group and row.judgement != MISSING]
        if rows:
            kinds = [row.judgement for row in rows]
            opened = any(kind in (BETTER, WORSE, UNSURE) for kind in kinds)
            families.append(ChangeFamily(group, _pills(kinds).pills, opened, tuple(map(_row, rows))))
    return tuple(families)


def _pills(kinds: list[str]) -> Pills:
    return Pills(tuple(Pill(tone, f"{kinds.count(kind)} {kind}") for kind, tone in TONES.items() if kind in kinds))


def _row(row: Row) -> ChangeRow:
    definition = row.a.definition
    return ChangeRow(
        definition.name,
        definition.label,
        definition.meaning,
        number(row.a.value, definition.unit),
        interval(row.a),
        number(row.b.value, definition.unit),
        interval(row.b),
        change_text(row),
        Pill(TONES[row.judgement], row.judgement),
    )


def _reading(metric: Metric) -> str:
    if not math.isfinite(metric.value):
        return "–"
    bar = f" ± {number(metric.error)}" if math.isfinite(metric.error) else ""
    return f"{number(metric.value)}{bar} {metric.definition.unit}".strip()
