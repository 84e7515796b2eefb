"""The commands of experiments."""

from __future__ import annotations

import shlex
from collections import Counter
from dataclasses import replace

import pytest

from gazenerf.cli.main import build_parser
from gazenerf.cli.parser import parsed
from gazenerf.errors import UserError
from gazenerf.experiments.options import ExperimentOptions
from gazenerf.experiments.run import plan_experiment
from gazenerf.training.gaze_estimator import BUNDLED
from gazenerf.training.run import TrainOptions, chosen_config

SMALL = 'field_overrides={"feature_size": 16}'


def commands(options: ExperimentOptions) -> list[list[str]]:
    return [shlex.split(line)[1:] for line, _ in plan_experiment(options).lines()]


def trainings(options: ExperimentOptions) -> dict[str, TrainOptions]:
    """Folder to what is trained in it, as the command line understands it."""
    parser = build_parser(["train"])
    found = [parsed(TrainOptions, parser.parse_args(words)) for words in commands(options) if words[0] == "train"]
    return {asked.out.name: asked for asked in found}


def test_a_plan_is_commands_that_can_be_typed(options: ExperimentOptions):
    parser = build_parser(["train", "train-estimator", "evaluate"])
    for words in commands(options):
        parser.parse_args(words)
    names = [words[0] for words in commands(options)]
    assert Counter(names) == {"train-estimator": 2, "train": 3, "evaluate": 3} and names[0] == "train-estimator"
    assert not options.out.exists()


def test_gazenerf_has_the_functional_loss_by_an_estimator_that_does_not_measure(options: ExperimentOptions):
    found = trainings(options)
    assert chosen_config(found["gazenerf"]).functional == 1.0
    assert found["gazenerf"].gaze_estimator == options.out / "estimators" / "loss-estimator.safetensors"
    assert chosen_config(found["headnerf"]).functional == 0.0 and found["headnerf"].gaze_estimator is None
    typed = replace(options, settings=(*options.settings, "functional=3"))
    weights = {name: chosen_config(asked).functional for name, asked in trainings(typed).items() if name != "sted"}
    assert weights == {"headnerf": 0.0, "gazenerf": 3.0}, "a weight that is set for all is not given to rows without it"


def test_the_ladder_learns_codes_in_all_its_rows(options: ExperimentOptions):
    some = replace(options, experiment="losses", settings=(*options.settings, "perceptual_backbone=alexnet"))
    found = trainings(replace(some, models=("R", "R+P")))
    assert list(found) == ["R", "R+P"] and all(chosen_config(asked).learn_codes for asked in found.values())
    with pytest.raises(UserError, match="perceptual loss compares features"):
        plan_experiment(replace(some, settings=options.settings))


def test_equal_trainings_are_made_once(options: ExperimentOptions):
    """Where codes are learned anyway, the ladder's last row is the GazeNeRF of the other tables."""
    settings = (*options.settings, "learn_codes=true", "disentanglement=1", "perceptual=1", "functional=1",
                "perceptual_backbone=alexnet")  # fmt: skip
    ladder = replace(options, experiment="losses", models=("R+P", "R+P+D+F"), settings=settings)
    assert list(trainings(ladder)) == ["R+P", "gazenerf"]


def test_a_headnerf_is_trained_to_start_from_unless_one_is_given(options: ExperimentOptions):
    asked = replace(options, experiment="pretrained")
    found = trainings(asked)
    assert list(found) == ["gazenerf", "headnerf", "gazenerf-from-headnerf"]
    started = found["gazenerf-from-headnerf"]
    assert started.initial == options.out / "models" / "headnerf" / "field.safetensors"
    assert started.settings == found["gazenerf"].settings
    with pytest.raises(UserError, match=r"nothing\.safetensors"):
        plan_experiment(replace(asked, initial=options.out / "nothing.safetensors"))


def test_minutes_are_those_of_every_training(options: ExperimentOptions):
    found = trainings(
        replace(options, minutes=5.0, preset="portrait", settings=(SMALL,), sted_settings=("features=0",))
    )
    assert found["sted"].stop_after == 5.0 and found["sted"].minutes is None and found["sted"].preset == "paper"
    assert found["headnerf"].minutes == 5.0 and found["headnerf"].preset == "portrait"


def test_the_estimator_that_measures_is_not_learned_by(options: ExperimentOptions):
    with pytest.raises(UserError, match="are the same; models would learn to please"):
        plan_experiment(replace(options, gaze_estimator=BUNDLED, loss_estimator=BUNDLED))
    trained = [words for words in commands(replace(options, gaze_estimator=BUNDLED)) if words[0] == "train-estimator"]
    assert len(trained) == 1 and any("loss-estimator" in word for word in trained[0])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"preset": "smal"}, r"unknown preset 'smal' \(did you mean small\?\)"),
        ({"settings": ("stps=2",)}, "unknown training settings: stps"),
        ({"settings": ("pixel_error=l2",)}, "rows of an experiment differ in it"),
        ({"settings": ('field_overrides={"streams": "one"}',)}, "--set streams"),
        ({"gaze_estimator": "none.safetensors"}, "no gaze estimator at"),
        ({"experiment": "calibration", "real": (8,), "samples": 20}, "8 real ones"),
    ],
)
def test_mistakes_are_one_line(options: ExperimentOptions, changes, message, tmp_path):
    changes = {name: tmp_path / value if name.endswith("estimator") else value for name, value in changes.items()}
    with pytest.raises(UserError, match=message):
        plan_experiment(replace(options, **changes))
    assert not options.out.exists()
