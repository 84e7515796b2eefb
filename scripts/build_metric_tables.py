"""Write the tables of metrics into the docs from their definitions: python scripts/build_metric_tables.py [--faults]

Tables stand between `<!-- metrics: GROUP -->` and `<!-- end -->`. With `--faults` the matrix of faults is measured
again too, which takes minutes.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterable
from pathlib import Path

from gazenerf.viz.metrics.definitions import Definition
from gazenerf.viz.metrics.families import CHECK_DEFINITIONS, FRAMES_DEFINITIONS

DOCS = Path(__file__).parent.parent / "docs"
PAGES = {"consistency.md": CHECK_DEFINITIONS, "consistency-of-others.md": FRAMES_DEFINITIONS}
"""Page to the metrics that it defines."""

MARKED = re.compile(r"(<!-- metrics: (.+?) -->\n)(.*?)(<!-- end -->)", re.DOTALL)
FAULTS = "matrix of faults"
"""What is between the markers in place of a group."""


def table(definitions: Iterable[Definition]) -> str:
    """Metrics as Markdown: name and label, meaning, definition, unit and thresholds."""
    lines = ["| metric | what it says | how it is computed | unit | passes | warns |", "|---|---|---|---|---|---|"]
    for one in definitions:
        sign = "≥" if one.higher_is_better else "≤"
        lines.append(
            f"| `{one.name}`<br>{one.label} | {one.meaning} | {one.method} | {one.unit or '–'} | "
            f"{sign}&nbsp;{one.passes:g} | {sign}&nbsp;{one.warns:g} |"
        )
    return "\n".join(lines) + "\n"


def filled(page: str, definitions: tuple[Definition, ...], faults: str | None = None) -> str:
    """A page with its tables made anew.

    Args:
        page: Its text.
        definitions: Of the metrics that it defines.
        faults: The matrix of faults as Markdown; what stands there stays when None.

    Raises:
        ValueError: a group is named that has no metrics, or one is left out.
    """
    groups = list(dict.fromkeys(one.group for one in definitions))
    named = [group for _, group, *_ in MARKED.findall(page) if group != FAULTS]
    if sorted(named) != sorted(groups):
        raise ValueError(f"tables of {named}, metrics of {groups}")

    def fill(found: re.Match[str]) -> str:
        start, group, old, end = found.groups()
        if group == FAULTS:
            return start + (old if faults is None else f"\n{faults}\n\n") + end
        return f"{start}\n{table(one for one in definitions if one.group == group)}\n{end}"

    return MARKED.sub(fill, page)


def main() -> None:
    """Rewrite the pages."""
    parser = argparse.ArgumentParser(description="Write the tables of metrics into the docs from their definitions.")
    parser.add_argument("--faults", action="store_true", help="measure the matrix of faults again, which takes minutes")
    faults = None
    if parser.parse_args().faults:
        from gazenerf.viz.selftest.faults import table as measured_faults

        faults = measured_faults()
    for name, definitions in PAGES.items():
        path = DOCS / name
        path.write_text(filled(path.read_text(encoding="utf-8"), definitions, faults), encoding="utf-8")


if __name__ == "__main__":
    main()
