"""Experiments from captures to their files."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest
from PIL import Image

from gazenerf.cli.main import main
from gazenerf.errors import UserError
from gazenerf.experiments.options import ExperimentOptions
from gazenerf.experiments.run import run_experiment

from .conftest import FIELD, Commands, write_toys


def test_what_one_experiment_made_the_others_use(options: ExperimentOptions, commands: Commands, tmp_path):
    found = run_experiment(options, run=commands)
    assert not found.failed and commands.trained == ["sted", "headnerf", "gazenerf"]
    assert [path.name for path in found.written] == ["within.json", "within.md", "within.tex", "within.png"]
    result = json.loads((options.out / "within.json").read_text())
    assert result == json.loads(json.dumps(found.result))
    rows = result["sets"]["held-out"]["rows"]
    report = json.loads((options.out / "evaluations" / "held-out" / "gazenerf.json").read_text())
    assert rows["gazenerf"]["measurements"] == report["measurements"] and report["pairs"]["measured"] == 1
    assert result["sets"]["held-out"]["estimator_error"]["gaze_estimator_deg"]["mean"] > 0
    assert result["trainings"]["gazenerf"]["steps"] == 2 and result["trainings"]["gazenerf"]["machines"][0]["cpu"]
    pairs = (options.out / "pairs" / "held-out.json").read_bytes()

    before = len(commands.ran)
    assert run_experiment(options, run=commands).result == found.result and len(commands.ran) == before
    started = run_experiment(replace(options, experiment="pretrained"), run=commands)
    assert commands.trained[3:] == ["gazenerf-from-headnerf"] and not started.failed
    other = write_toys(tmp_path / "other", people=2, views=4, seed=5)
    cross = run_experiment(replace(options, experiment="cross", test=(f"lab={other}",)), run=commands)
    assert len(commands.trained) == 4 and cross.result["sets"]["lab"]["people"] == 2
    assert [path.name for path in cross.written][3:] == ["cross-lab.png"]
    width, height = Image.open(cross.written[3]).size
    assert width > 2 * height, "five columns of two people"
    assert "the paper on ColumbiaGaze" in (options.out / "cross.md").read_text().replace("The paper", "the paper")
    assert (options.out / "pairs" / "held-out.json").read_bytes() == pairs


def test_a_row_that_fails_is_listed_and_the_others_go_on(options: ExperimentOptions, commands: Commands):
    commands.fails = {"headnerf"}
    found = run_experiment(replace(options, models=("headnerf", "gazenerf")), run=commands)
    assert found.failed == {"headnerf on held-out": "headnerf failed: no luck"}
    rows = found.result["sets"]["held-out"]["rows"]
    assert rows["headnerf"]["failed"] == "headnerf failed: no luck" and "measurements" in rows["gazenerf"]
    assert "failed: headnerf failed" in (options.out / "within.md").read_text()
    commands.fails = set()
    assert not run_experiment(replace(options, models=("headnerf", "gazenerf")), run=commands).failed
    assert commands.trained == ["headnerf", "gazenerf", "headnerf"]


def test_without_an_estimator_there_is_no_table(options: ExperimentOptions, commands: Commands):
    commands.fails = {"train-estimator"}
    with pytest.raises(UserError, match="estimator that measures could not be trained: no luck"):
        run_experiment(replace(options, models=("headnerf",)), run=commands)
    assert not (options.out / "within.json").exists()


def test_models_of_other_settings_are_refused(options: ExperimentOptions, commands: Commands):
    only = replace(options, models=("headnerf",))
    run_experiment(only, run=commands)
    with pytest.raises(UserError, match=r"headnerf with other settings \(steps 2, not 3\)"):
        run_experiment(replace(only, settings=("steps=3", FIELD)), run=commands)
    more = run_experiment(replace(only, limit=2), run=commands)
    assert more.result["sets"]["held-out"]["pairs"]["measured"] == 2, "another number of pairs is measured anew"
    assert commands.trained == ["headnerf"]


def test_a_training_that_was_stopped_goes_on(options: ExperimentOptions, commands: Commands):
    only = replace(options, models=("headnerf",))
    run_experiment(only, run=commands)
    record = options.out / "models" / "headnerf" / "experiment.json"
    record.write_text(json.dumps(json.loads(record.read_text()) | {"finished": False}))
    run_experiment(only, run=commands)
    assert "--resume" in next(words for words in reversed(commands.ran) if words[0] == "train")


def test_the_command_says_what_it_would_do(options: ExperimentOptions, capsys):
    words = ["experiment", "within", "--data", str(options.data), "--out", str(options.out), "--preset", "tiny",
             "--network", "small", "--models", "headnerf"]  # fmt: skip
    assert main([*words, "--dry-run"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[1] for line in lines] == ["train-estimator", "train", "evaluate"]
    assert main([*words, "--dry-run", "--json"]) == 0
    plan = json.loads(capsys.readouterr().out)["measured"]["plan"]
    assert [row["command"] for row in plan] == lines and not any(row["done"] for row in plan)
    assert not options.out.exists()
    assert main([word if word != "within" else "witin" for word in words]) == 2
    assert "did you mean within?" in capsys.readouterr().err
