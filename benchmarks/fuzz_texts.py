"""Examples of the texts that commands read back: reports of checks, and files of options."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from gazenerf.cli.main import load_command
from gazenerf.cli.option_files import read_options, save_options
from gazenerf.cli.parser import made
from gazenerf.viz.check.compare import compare_reports
from gazenerf.viz.metrics.definitions import Metric
from gazenerf.viz.metrics.families import CHECK_DEFINITIONS, CHECK_VERSION
from gazenerf.viz.report.comparison import terminal_rows, write_comparison

OPTIONS: dict[str, dict[str, Any]] = {
    "orbit": {
        "out": "a.mp4",
        "frames": 7,
        "gaze": ((1.5, -2.0), (3.0, 4.0)),
        "panels": ("image", "depth"),
        "fov": 14.0,
    },
    "mesh": {"out": "m", "use": "web", "threshold": "p50", "holes_mm": 1.5, "rig": True, "parts": ("face", "eyes")},
}
"""Command to options of it."""


def write_reports(folder: Path) -> list[str]:
    """Two reports; the first is to be damaged."""
    metrics = [Metric(one, 0.25 + 0.01 * i, 0.01).to_dict() for i, one in enumerate(CHECK_DEFINITIONS[:6])]
    report = {"definitions": CHECK_VERSION, "about": {"subject": "someone", "size_px": 256}, "metrics": metrics}
    for name in ("a.json", "b.json"):
        (folder / name).write_text(json.dumps(report))
    return ["a.json"]


def read_reports(folder: Path) -> Any:
    """As `gazenerf check --compare` does; the page goes where it is not looked for and is removed."""
    comparison = compare_reports(folder / "a.json", folder / "b.json")
    page = write_comparison(comparison, folder)
    page.unlink()
    return terminal_rows(comparison)


def write_options(folder: Path) -> list[str]:
    """A file for each of `OPTIONS`, and one in TOML."""
    for command, options in OPTIONS.items():
        save_options(folder / f"{command}.json", command, options)
    (folder / "sheet.toml").write_text('out = "a.png"\npitches = [-10, 0.5]\nkind = "contact"\n')
    return ["orbit.json", "mesh.json", "sheet.toml"]


def read_some_options(folder: Path) -> list[Any]:
    """As commands do that take `--options`."""
    found = []
    for name in ("orbit.json", "mesh.json", "sheet.toml"):
        command = Path(name).stem
        kind = load_command(command).Options
        found.append(made(kind, {"out": Path("x")} | read_options(folder / name, kind, command)))
    return found
