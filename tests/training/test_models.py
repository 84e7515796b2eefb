"""The rows of the paper's tables as runs: what they learn, by which losses, and what can be done with the fields."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gazenerf.checkpoints import load_field
from gazenerf.cli.main import main
from gazenerf.errors import UserError
from gazenerf.field.config import PRESETS as FIELDS
from gazenerf.geometry import Camera, Gaze
from gazenerf.heads import Head
from gazenerf.subjects import Subject
from gazenerf.training.config import PRESETS, TrainConfig
from gazenerf.training.models import LADDER, MODELS
from gazenerf.training.run import TrainOptions, chosen_config


def chosen(**given: Any) -> TrainConfig:
    return chosen_config(TrainOptions(data=Path("d"), out=Path("o"), **given))


def field_of(config: TrainConfig) -> tuple[str, str]:
    field = FIELDS[config.field_preset].to_dict() | config.field_overrides
    return field["streams"], field["eye_motion"]


def losses_of(config: TrainConfig) -> tuple[float, float, float]:
    return config.perceptual, config.disentanglement, config.functional


@pytest.mark.parametrize(
    ("model", "streams", "motion", "pixel_error", "functional"),
    [
        ("headnerf", "one", "none", "l2", 0.0),
        ("vanilla", "one", "none", "l1", 0.0),
        ("vanilla+rotation", "one", "feature_rotation", "l1", 0.0),
        ("two-stream", "two", "none", "l1", 0.0),
        ("two-stream+rotation", "two", "feature_rotation", "l1", 0.0),
        ("vanilla+functional", "one", "none", "l1", 1.0),
        ("gazenerf", "two", "feature_rotation", "l1", 1.0),
    ],
)
def test_a_model_is_its_row_of_the_papers_table(model, streams, motion, pixel_error, functional):
    config = chosen(model=model, preset="paper")
    assert field_of(config) == (streams, motion)
    assert (config.pixel_error, config.functional) == (pixel_error, functional)
    assert (config.reconstruction, config.perceptual, config.disentanglement) == (1.0, 1.0, 1.0)
    changed = {name for name, value in config.to_dict().items() if value != PRESETS["paper"].to_dict()[name]}
    assert changed <= {"field_overrides", "pixel_error", "functional"}
    assert len({MODELS[name].row for name in MODELS}) == len(MODELS) == 7


@pytest.mark.parametrize("preset", PRESETS)
def test_a_run_without_a_model_is_the_preset(preset):
    assert chosen(preset=preset) == PRESETS[preset]


@pytest.mark.parametrize(
    ("step", "weights"),
    [("R", (0.0, 0.0, 0.0)), ("R+P", (1.0, 0.0, 0.0)), ("R+P+D", (1.0, 1.0, 0.0)), ("R+P+D+F", (1.0, 1.0, 1.0))],
)
def test_a_step_of_the_ladder_adds_one_loss(step, weights):
    config = chosen(losses=step, preset="paper")
    assert losses_of(config) == weights and config.learn_codes
    assert field_of(config) == ("two", "feature_rotation") and len(LADDER) == 4


def test_losses_keep_a_presets_weights_and_win_over_the_models():
    assert losses_of(chosen(losses="R+P")) == (PRESETS["small"].perceptual, 0.0, 0.0)
    assert losses_of(chosen(losses="R")) == (0.0, 0.0, 0.0)
    config = chosen(model="vanilla", losses="R+P+D+F", preset="paper")
    assert config == chosen(model="vanilla+functional", preset="paper")


def test_what_is_typed_wins_and_field_settings_are_added():
    settings = ('field_overrides={"hidden": 96}', "functional=0.5", "pixel_error=l1")
    config = chosen(model="headnerf", settings=settings)
    assert config.field_overrides == {"streams": "one", "eye_motion": "none", "hidden": 96}
    assert (config.functional, config.pixel_error) == (0.5, "l1")


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"model": "headnerv"}, "did you mean headnerf"),
        ({"losses": "R+F"}, r"there are R, R\+P, R\+P\+D, R\+P\+D\+F"),
        ({"losses": "R+P+D"}, "learn_codes=true"),
        ({"losses": "R+P", "preset": "tiny"}, "perceptual_backbone=alexnet"),
        ({"settings": ("field_overrides=3",)}, "give an object"),
    ],
)
def test_what_cannot_be_is_one_line(given, message):
    with pytest.raises(UserError, match=message) as caught:
        chosen(**given)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("model", ["headnerf", "vanilla+rotation", "two-stream"])
def test_a_model_is_trained_and_its_file_is_what_it_says(toy_folder, toy_captures, tmp_path, capsys, model):
    settings = ["steps=2", "eyeball=0", 'field_overrides={"feature_size": 16}']
    words = ["--data", str(toy_folder), "--out", str(tmp_path / "run"), "--preset", "tiny", "--model", model]
    assert main(["train", *words, "--device", "cpu", "--set", *settings]) == 0
    field = load_field(tmp_path / "run" / "field.safetensors")
    assert (field.config.streams, field.config.eye_motion) == field_of(chosen(model=model))
    assert field.config.gaze_input and field.config.eyes_box is None
    assert field.about["model"] == model
    assert field.about["training"]["pixel_error"] == ("l2" if model == "headnerf" else "l1")
    head = Head(field, Subject("toy", toy_captures[0].codes))
    looks = [head.at(Gaze(0.0, yaw)).render(Camera.neutral(32)).image for yaw in (-0.4, 0.4)]
    assert np.isfinite(looks[0]).all() and np.abs(looks[0] - looks[1]).max() > 1e-6, "the gaze is an input"


def test_parts_that_a_one_stream_field_lacks_are_refused_in_one_line(toy_folder, toy_captures, tmp_path, capsys):
    words = ["--data", str(toy_folder), "--out", str(tmp_path / "run"), "--preset", "tiny", "--model", "headnerf"]
    settings = ["steps=1", "eyeball=0", 'field_overrides={"feature_size": 16}']
    assert main(["train", *words, "--device", "cpu", "--set", *settings]) == 0
    Subject("toy", toy_captures[0].codes).save(tmp_path / "toy.safetensors")
    capsys.readouterr()
    source = [
        "--checkpoint",
        str(tmp_path / "run" / "field.safetensors"),
        "--subject",
        str(tmp_path / "toy.safetensors"),
    ]
    for command in (["mesh", "--parts", "eyes"], ["export", "--part", "eyes", "--size", "32", "--frames", "1"]):
        assert main([*command, *source, "--out", str(tmp_path / command[0])]) == 2
        said = capsys.readouterr().err.strip().splitlines()
        assert len(said) == 1 and "it has no eyes alone; ask for head" in said[0]
        assert not [path for path in (tmp_path / command[0]).rglob("*") if path.is_file()]
