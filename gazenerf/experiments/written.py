"""The files of a result: JSON for programs, Markdown and LaTeX for people, a figure of the calibration."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gazenerf.experiments.figure import draw_calibration
from gazenerf.experiments.tables import ResultTable, costs_table, notes_of, tables_of
from gazenerf.files import whole_file

LATEX = {
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_", "{": r"\{", "}": r"\}",
    "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "↑": r"$\uparrow$", "↓": r"$\downarrow$",
}  # fmt: skip


def write_result(result: Mapping[str, Any], out: Path) -> tuple[Path, ...]:
    """Write `NAME.json`, `NAME.md`, `NAME.tex`, and of a calibration `NAME.png` and `NAME.pdf`.

    Raises:
        UserError: the folder cannot be written.
    """
    name = str(result["experiment"])
    texts = {
        ".json": json.dumps(result, indent=1) + "\n",
        ".md": markdown(result),
        ".tex": latex(result),
    }
    written = []
    for suffix, text in texts.items():
        written.append(out / f"{name}{suffix}")
        with whole_file(written[-1]) as temporary:
            temporary.write_text(text, encoding="utf-8")
    if name == "calibration":
        for suffix in (".png", ".pdf"):
            written.append(out / f"{name}{suffix}")
            draw_calibration(result, written[-1])
    return tuple(written)


def markdown(result: Mapping[str, Any]) -> str:
    """All tables and notes."""
    parts = [_markdown_table(table) for table in (*tables_of(result), costs_table(result))]
    return "\n".join([f"# {result['experiment']}\n", *parts, *(f"{note}\n" for note in notes_of(result))])


def _markdown_table(table: ResultTable) -> str:
    def line(cells: tuple[str, ...], italic: bool = False) -> str:
        shown = (cell.replace("|", "\\|") for cell in cells)
        return f"| {' | '.join(f'*{cell}*' if italic and cell != '-' else cell for cell in shown)} |\n"

    rule = f"|{'|'.join('---' for _ in table.headings)}|\n"
    rows = "".join(line(row.cells, row.published) for row in table.rows)
    return f"{table.title[0].upper()}{table.title[1:]}\n\n{line(table.headings)}{rule}{rows}"


def latex(result: Mapping[str, Any]) -> str:
    r"""The tables as `table` environments for `\input`; they need the package booktabs."""
    notes = " ".join(notes_of(result))
    made = [_latex_table(table, notes if number == 0 else "") for number, table in enumerate(tables_of(result))]
    return "% needs \\usepackage{booktabs}\n" + "\n".join(made)


def _latex_table(table: ResultTable, notes: str) -> str:
    def line(cells: tuple[str, ...], italic: bool = False) -> str:
        shown = (escaped(cell) for cell in cells)
        return " & ".join(f"\\textit{{{cell}}}" if italic and cell != "-" else cell for cell in shown) + r" \\"

    rows = "\n".join(line(row.cells, row.published) for row in table.rows)
    caption = escaped(" ".join(part for part in (f"{table.title[0].upper()}{table.title[1:]}.", notes) if part))
    return (
        "\\begin{table*}[t]\n\\centering\\small\n"
        f"\\begin{{tabular}}{{l{'c' * (len(table.headings) - 1)}}}\n\\toprule\n{line(table.headings)}\n\\midrule\n"
        f"{rows}\n\\bottomrule\n\\end{{tabular}}\n\\caption{{{caption}}}\n\\end{{table*}}\n"
    )


def escaped(text: str) -> str:
    """Text as LaTeX prints it."""
    return "".join(LATEX.get(character, character) for character in text)
