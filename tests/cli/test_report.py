"""`--json`, `--quiet` and `--verbose`: one mechanism, on every command."""

from __future__ import annotations

import json
import math
import sys
import warnings
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from gazenerf.cli import main as frame
from gazenerf.cli.common import showing_progress, summary_table, warn
from gazenerf.cli.main import COMMANDS, build_parser, main
from gazenerf.cli.report import json_value
from gazenerf.heads.analytic import AnalyticHead


def command(monkeypatch: pytest.MonkeyPatch, run: Any) -> None:
    """Put a command of our own in the place of `view`."""
    monkeypatch.setattr(frame, "load_command", lambda name: SimpleNamespace(run=run))


def talkative(args: object) -> int:
    """Says something in every way."""
    print("by the way")
    warn("mind the\n gap")
    warnings.warn("a library warns", stacklevel=1)
    with showing_progress() as progress:
        progress("drawing, 3 left", 1, 2)
        progress("drawing", 2, 2)
    summary_table("title", {"file": Path("a.png"), "size": "3 of 4"}, {"share": math.nan, "sides": (3, 4)})
    return 1


def test_json_is_the_only_thing_on_standard_output(monkeypatch, capsys) -> None:
    command(monkeypatch, talkative)
    assert main(["view", "--json"]) == 1
    captured = capsys.readouterr()
    said = json.loads(captured.out)
    assert said["command"] == "view" and said["exit_code"] == 1 and said["written"] == ["a.png"]
    assert said["measured"] == {"share": None, "sides": [3, 4]}
    assert said["warnings"] == ["mind the gap", "a library warns"]
    assert set(said["seconds"]) == {"drawing", "all"} and "torch" in said["versions"]
    assert captured.err.splitlines()[0] == "by the way" and "title" not in captured.err


def test_quiet_says_nothing(monkeypatch, capsys) -> None:
    monkeypatch.setenv("GAZENERF_PROGRESS", "lines")
    command(monkeypatch, talkative)
    assert main(["view", "--quiet"]) == 1
    captured = capsys.readouterr()
    assert captured.out == "" and captured.err == ""
    assert sys.stdout.write  # the stream is the former one again
    print("still here")
    assert capsys.readouterr().out == "still here\n"


def test_quiet_and_json_are_one_object(monkeypatch, capsys) -> None:
    command(monkeypatch, talkative)
    assert main(["view", "--quiet", "--json"]) == 1
    captured = capsys.readouterr()
    assert json.loads(captured.out)["exit_code"] == 1 and captured.err == ""


def test_errors_are_on_standard_error_whatever_is_asked_for(tmp_path, capsys) -> None:
    for flag in ("--json", "--quiet", "--verbose"):
        assert main(["orbit", "--out", str(tmp_path / "a.mp4"), "--frames", "0", flag]) == 2
        captured = capsys.readouterr()
        assert captured.out == "" and captured.err.splitlines()[-1].startswith("gazenerf: error: ")


def test_quiet_and_verbose_exclude_each_other(capsys) -> None:
    with pytest.raises(SystemExit) as stop:
        main(["subjects", "--quiet", "--verbose"])
    assert stop.value.code == 2 and "not allowed with" in capsys.readouterr().err


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_takes_them(name) -> None:
    flags = {flag for action in _command(name)._actions for flag in action.option_strings}
    assert {"--json", "--quiet", "--verbose", "--options", "--save-options"} <= flags


def _command(name):
    [chosen] = [action for action in build_parser([name])._actions if hasattr(action, "choices") and action.choices]
    return chosen.choices[name]


def test_verbose_says_what_was_chosen_and_how_long_it_took(tmp_path, capsys) -> None:
    words = ["--out", str(tmp_path / "s.png"), "--size", "16", "--pitches", "0", "--yaws", "0", "--crop", "whole"]
    assert main(["sheet", *words, "--checkpoint", "small", "--subject", "noa", "--verbose", "--device", "cpu"]) == 0
    first, chosen, seconds = capsys.readouterr().err.splitlines()
    assert first.startswith("gazenerf: gazenerf ") and "torch 2." in first and "Python 3." in first
    assert "subject noa, field small, weights " in chosen and "device cpu, precision float32" in chosen
    assert all(f"{what} " in seconds for what in ("loading", "rendering", "all"))


def test_what_a_command_is_asked_to_print_is_printed_quietly_too(capsys) -> None:
    assert main(["subjects", "--quiet"]) == 0 and "noa" in capsys.readouterr().out
    assert main(["completion", "bash", "--quiet"]) == 0 and "gazenerf" in capsys.readouterr().out
    assert main(["check", "--list-metrics", "--quiet"]) == 0 and "depth" in capsys.readouterr().out


def test_lists_are_objects_where_json_is_asked_for(capsys) -> None:
    assert main(["check", "--list-metrics", "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)["measured"]["gazenerf check"]
    assert {"name", "unit", "passes", "meaning", "higher_is_better"} == set(listed[0]) and len(listed) > 30
    assert main(["completion", "bash", "--json"]) == 0
    assert "complete" in json.loads(capsys.readouterr().out)["measured"]["script"]
    assert main(["subjects", "--json"]) == 0, "its own list, as before"
    assert {"name", "code_sizes"} <= set(json.loads(capsys.readouterr().out)[0])


def test_measured_values_of_real_commands_are_numbers(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.setattr("gazenerf.cli.arguments.SourceArguments.load", lambda self: AnalyticHead())
    out = tmp_path / "o"
    assert main(["orbit", "--out", str(out), "--frames", "3", "--size", "16", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["measured"]["frames"] == 3 and said["measured"]["path"] == "exact"
    assert said["written"] == [str(out / "orbit.json"), *(str(out / f"000{i}.png") for i in range(3))]
    words = ["--parts", "eyes", "--resolution", "24", "--formats", "ply"]
    assert main(["mesh", "--out", str(tmp_path / "m"), *words, "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["measured"]["eyes"]["watertight"] is True and said["measured"]["eyes"]["vertices"] > 100
    assert str(tmp_path / "m" / "eyes.ply") in said["written"]
    words = ["--size", "16", "--frames", "2", "--points", "10", "--json"]
    assert main(["export", "--out", str(tmp_path / "e"), *words]) == 0
    assert json.loads(capsys.readouterr().out)["measured"]["pictures"] == 2


def test_values_are_plain() -> None:
    given = {"a": np.arange(2), "b": np.float32(0.5), "c": (Path("x"), math.inf, None, True), 3: {"d": np.nan}}
    assert json_value(given) == {"a": [0, 1], "b": 0.5, "c": ["x", None, None, True], "3": {"d": None}}
