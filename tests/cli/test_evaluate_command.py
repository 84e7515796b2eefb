"""`gazenerf evaluate --protocol paper` from its words to its tables."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from gazenerf.checkpoints import save_field
from gazenerf.cli.main import main
from gazenerf.evaluation.redirection import PaperInstruments
from tests.evaluation.made_captures import write_captures
from tests.field_doubles import make_field, tiny_config


@pytest.fixture
def words(tmp_path: Path, monkeypatch) -> list[str]:
    save_field(make_field(tiny_config(identity=2, expression=2, texture=2)), tmp_path / "field.safetensors")
    monkeypatch.setattr("gazenerf.evaluation.paper._instruments", lambda *_: PaperInstruments())
    write_captures(tmp_path / "captures")
    return [
        "evaluate", "--protocol", "paper", "--data", str(tmp_path / "captures"), "--held-out", "2", "--limit", "1",
        "--checkpoint", str(tmp_path / "field.safetensors"), "--device", "cpu", "--out", str(tmp_path / "q.json"),
    ]  # fmt: skip


def test_numbers_are_printed_with_intervals(words, tmp_path: Path, capsys):
    assert main([*words, "--pairs", str(tmp_path / "p.json")]) == 0
    printed = capsys.readouterr().out
    assert "2 redirections of 2 people" in printed and " to " in printed and "Student's t" in printed
    mean = json.loads((tmp_path / "q.json").read_text())["measurements"]["psnr"]["mean"]
    assert f"{mean:.3g} dB" in printed
    assert main([*words, "--pairs", str(tmp_path / "p.json"), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["measured"]["measurements"]["psnr"]["method"] == "t"
    assert str(tmp_path / "p.json") in json.dumps(said["written"])


def test_mistakes_are_one_line(words, tmp_path: Path, capsys):
    assert main(words) == 2
    assert "needs --pairs FILE" in capsys.readouterr().err
    (tmp_path / "p.json").write_text('{"format": "gazenerf-pairs-1", "data": "0", "seed": 0, "pairs": {}}')
    assert main([*words, "--pairs", str(tmp_path / "p.json")]) == 2
    error = capsys.readouterr().err
    assert "other data" in error and len(error.splitlines()) == 1
