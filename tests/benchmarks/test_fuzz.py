"""Damaged files are read or refused in one line, and what goes wrong is found."""

from __future__ import annotations

import json
import time
from pathlib import Path

import pytest

from benchmarks import fuzz as module
from benchmarks.fuzz import TARGETS, Target, fuzz


@pytest.mark.parametrize("kind", TARGETS)
def test_every_example_is_sound_before_it_is_damaged(kind: str, tmp_path: Path) -> None:
    names = TARGETS[kind].write(tmp_path)
    assert all((tmp_path / name).is_file() for name in names)
    assert TARGETS[kind].read(tmp_path) is not None


def test_nothing_goes_wrong() -> None:
    outcomes, findings = fuzz(cases=180, seed=20, seconds=30.0)
    assert not findings, "\n".join(f"{found.kind}, case {found.case}, {found.how}: {found.what}" for found in findings)
    assert outcomes.total() == 180
    refused = sum(count for (_, outcome), count in outcomes.items() if outcome == "refused")
    assert 60 < refused < 170, "damage is felt, and not everything is destroyed"


def planted(folder: Path) -> object:
    """A reader with three faults."""
    number = json.loads((folder / "a.json").read_text())[0]["number"]
    if number == -1:
        (folder / "left.txt").write_text("half")
    if number == 0:
        time.sleep(0.3)
    return 1 / abs(number) if number else None


def test_tracebacks_files_and_slowness_are_found_and_come_again(tmp_path: Path) -> None:
    def write(folder: Path) -> list[str]:
        (folder / "a.json").write_text(json.dumps([{"number": 5}]))
        return ["a.json"]

    targets = {"planted": Target(write, planted)}
    outcomes, findings = fuzz(cases=250, seed=1, targets=targets, seconds=0.2, keep=tmp_path)
    said = [found.what for found in findings]
    assert any("TypeError" in what for what in said) and any("JSONDecodeError" in what for what in said)
    assert "files appeared or went" in said and any(what.startswith("took") for what in said)
    assert outcomes["planted", "went wrong"] == len({found.case for found in findings})
    assert (tmp_path / f"planted-{findings[0].case}" / "a.json").is_file()
    again = module.run_case("planted", targets["planted"], 1, findings[0].case, make(tmp_path / "again"), 0.2)[1]
    assert again[0].how == findings[0].how


def make(folder: Path) -> Path:
    folder.mkdir()
    return folder
