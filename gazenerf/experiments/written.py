"""The files of a result: JSON for programs, Markdown and LaTeX for people, a figure of the calibration."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path
from textwrap import wrap
from typing import Any

from gazenerf.experiments.figure import draw_calibration
from gazenerf.experiments.tables import FAILED, NONE, ResultTable, TableRow, costs_table, notes_of, tables_of
from gazenerf.files import whole_file

LATEX = {
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_", "{": r"\{", "}": r"\}",
    "<": r"\textless{}", ">": r"\textgreater{}", "|": r"\textbar{}", "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}", "↑": r"$\uparrow$", "↓": r"$\downarrow$",
}  # fmt: skip


HEADING = 12
"""Characters after which a heading of a LaTeX table goes on in another line."""

_INTERVAL = re.compile(r"(\S+) \((\S+ to \S+)\)")
_MINUS = re.compile(r"(?<![{\d])-(?=\d)")
_POWER = re.compile(r"e([+-]\d+)")


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
    r"""The tables as `table*` environments for `\input`, no wider than the text."""
    notes = " ".join(notes_of(result))
    made = [_latex_table(table, notes if number == 0 else "") for number, table in enumerate(tables_of(result))]
    return "% needs \\usepackage{booktabs,graphicx}\n" + "\n".join(made)


def _latex_table(table: ResultTable, notes: str) -> str:
    columns = len(table.headings)

    def line(row: TableRow) -> str:
        if len(row.cells) > 1 and row.cells[1].startswith(FAILED):
            return f"{escaped(row.cells[0])} & \\multicolumn{{{columns - 1}}}{{l}}{{failed}} \\\\"
        shown = (_latex_cell(cell) for cell in row.cells)
        return " & ".join(f"\\textit{{{cell}}}" if row.published else cell for cell in shown) + r" \\"

    stacked = (_stacked([escaped(part) for part in wrap(text, HEADING)]) for text in table.headings[1:])
    heading = " & ".join([escaped(table.headings[0]), *stacked]) + r" \\"
    rows = "\n\\addlinespace[2pt]\n".join(line(row) for row in table.rows)
    caption = escaped(" ".join(part for part in (f"{table.title[0].upper()}{table.title[1:]}.", notes) if part))
    return (
        "\\begin{table*}[t]\n\\centering\\small\\setlength{\\tabcolsep}{4pt}\n"
        "\\resizebox{\\ifdim\\width>\\linewidth\\linewidth\\else\\width\\fi}{!}{%\n"
        f"\\begin{{tabular}}{{l{'c' * (columns - 1)}}}\n\\toprule\n{heading}\n\\midrule\n"
        f"{rows}\n\\bottomrule\n\\end{{tabular}}}}\n\\caption{{{caption}}}\n\\end{{table*}}\n"
    )


def _latex_cell(cell: str) -> str:
    """A cell; an interval stands below its mean, and numbers have minus signs."""
    if cell == NONE:
        return "--"
    if (found := _INTERVAL.fullmatch(cell)) is None:
        return escaped(cell)
    mean, interval = (_MINUS.sub("$-$", _POWER.sub(_power, text)) for text in found.groups())
    return _stacked([mean, f"[-3pt]{{\\scriptsize {interval}}}"])


def _power(found: re.Match[str]) -> str:
    return f"$\\cdot10^{{{int(found[1])}}}$"


def _stacked(lines: list[str]) -> str:
    """Lines below one another, the first on the row's own line."""
    if len(lines) == 1:
        return lines[0]
    return f"\\begin{{tabular}}[t]{{@{{}}c@{{}}}}{(chr(92) * 2).join(lines)}\\end{{tabular}}"


def escaped(text: str) -> str:
    """Text as LaTeX prints it."""
    return "".join(LATEX.get(character, character) for character in text)
