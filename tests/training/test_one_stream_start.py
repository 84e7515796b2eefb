"""Starting from a field with one stream: what is copied where, and that the copy is the same function."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from benchmarks.fuzz_targets import published_weights
from gazenerf.checkpoints import load_field, save_field
from gazenerf.cli.main import main
from gazenerf.errors import UserError
from gazenerf.field.config import PRESETS, FieldConfig
from gazenerf.field.model import TwoStreamField
from gazenerf.training.initial import starting_field
from gazenerf.training.one_stream_start import left_out, with_conventions
from tests.field_doubles import make_field

SIZES: dict[str, Any] = {"identity": 4, "expression": 3, "texture": 5}
TWO = replace(PRESETS["tiny"], **SIZES)
HEADNERF = replace(TWO, streams="one", eye_motion="none", gaze_input=False)
"""As published: one stream that does not know the gaze."""


def sampled(field: TwoStreamField, stream: str, codes: bool = True) -> tuple[torch.Tensor, torch.Tensor]:
    """Density and features of a stream at some points, at codes and a gaze that are not zero."""
    generator = torch.Generator().manual_seed(7)
    config = field.config
    shape = torch.randn(1, config.identity + config.expression, generator=generator) * codes
    look = torch.randn(1, config.texture + config.illumination, generator=generator) * codes
    points = torch.randn(1, 50, 3, generator=torch.Generator().manual_seed(8))
    with torch.no_grad():
        return field.stream(stream)(points, shape, look, torch.tensor([[0.3, -0.2]]))


@pytest.mark.parametrize("motion", ["feature_rotation", "none", "rigid"])
def test_both_streams_start_as_the_only_one_and_do_not_know_the_gaze_yet(motion: str) -> None:
    known = make_field(HEADNERF)
    field = starting_field(replace(TWO, eye_motion=motion, merge="max"), known).eval()
    assert set(field.streams) == {"face", "eyes"} and field.config.eye_motion == motion
    for stream in ("face", "eyes"):
        for found, expected in zip(sampled(field, stream), sampled(known, "head"), strict=True):
            assert expected.std() > 0
            torch.testing.assert_close(found, expected)
    for name, value in known.renderer.state_dict().items():
        assert torch.equal(field.renderer.state_dict()[name], value), name


def test_streams_are_copies_that_learn_apart() -> None:
    known = make_field(HEADNERF)
    field = starting_field(TWO, known)
    with torch.no_grad():
        field.stream("eyes").feature_1.weight.zero_()
    assert field.stream("face").feature_1.weight.any() and known.stream("head").feature_1.weight.any()


def test_what_was_not_read_before_is_learned() -> None:
    field = starting_field(TWO, make_field(HEADNERF)).requires_grad_(True)
    points, codes = torch.randn(1, 50, 3), (torch.randn(1, 7), torch.randn(1, 32))
    density, features = field.stream("eyes")(points, *codes, torch.tensor([[0.3, -0.2]]))
    (density.sum() + features.square().sum()).backward()
    weight = dict(field.named_parameters())["streams.eyes.trunk.0.weight"]
    assert weight.grad is not None and float(weight.grad[:, -2:].abs().max()) > 0
    assert not weight[:, -2:].any()


def test_a_one_stream_field_with_the_gaze_keeps_it() -> None:
    known = make_field(replace(HEADNERF, gaze_input=True))
    field = starting_field(replace(TWO, eye_motion="none"), known).eval()
    for found, expected in zip(sampled(field, "face"), sampled(known, "head"), strict=True):
        torch.testing.assert_close(found, expected)
    again = starting_field(replace(HEADNERF, gaze_input=True, eye_motion="feature_rotation"), known).eval()
    assert set(again.streams) == {"head"}
    for found, expected in zip(sampled(again, "head"), sampled(known, "head"), strict=True):
        torch.testing.assert_close(found, expected)


def test_codes_of_another_head_model_are_not_read() -> None:
    known = make_field(HEADNERF)
    ours = replace(TWO, expression=9, texture=2)
    field = starting_field(ours, known).eval()
    straight = [sampled(known, "head", codes=False), sampled(field, "face", codes=False)]
    for expected, found in zip(*straight, strict=True):
        torch.testing.assert_close(found, expected)
    said = left_out(HEADNERF, ours)
    assert len(said) == 2 and "expression codes, 3 there and 9 here" in said[0] and "texture" in said[1]
    assert not left_out(HEADNERF, TWO) and not left_out(TWO, ours)


def test_more_feature_channels_leave_the_first_ones_as_they_were() -> None:
    known = make_field(replace(HEADNERF, feature_channels=22))
    field = starting_field(replace(TWO, feature_channels=24), known).eval()
    density, features = sampled(field, "face")
    before, expected = sampled(known, "head")
    torch.testing.assert_close(density, before)
    torch.testing.assert_close(features[..., :22], expected)
    assert float(features[..., 22:].abs().max()) == 0.0
    background = field.renderer.background_features
    assert torch.equal(background[:, :22], known.renderer.background_features)
    assert float(background[:, 22:].abs().max()) == 0.0
    first = field.renderer.to_rgb[0](features.transpose(1, 2)[..., None])
    torch.testing.assert_close(first, known.renderer.to_rgb[0](expected.transpose(1, 2)[..., None]))
    assert "than its 22" in left_out(known.config, field.config)[0]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"hidden": 64}, "it has hidden 64 where it needs 32;"),
        ({"feature_channels": 30}, "it has feature_channels 30 where it needs 24;"),
        ({"frequencies": 4}, "it has frequencies 4 where it needs 6;"),
        ({"density_activation": "relu"}, 'it has density_activation "relu" where it needs "softplus";'),
    ],
)
def test_other_sizes_are_refused_in_one_line(change: dict[str, Any], message: str) -> None:
    with pytest.raises(UserError, match=message) as caught:
        starting_field(TWO, TwoStreamField(replace(HEADNERF, **change)))
    assert "--model" in str(caught.value) and "\n" not in str(caught.value)


def test_two_streams_do_not_become_one() -> None:
    with pytest.raises(UserError, match='it has streams "two" where it needs "one"'):
        starting_field(replace(HEADNERF, gaze_input=True, eye_motion="feature_rotation"), TwoStreamField(TWO))


def test_conventions_are_the_checkpoints_unless_they_were_typed() -> None:
    published = replace(TWO, ray_offset=0.0, gaze_label_signs=(-1.0, -1.0))
    assert with_conventions(TWO, published) == published
    assert with_conventions(TWO, published, frozenset({"ray_offset"})) == replace(published, ray_offset=0.5)
    without_gaze = replace(HEADNERF, ray_offset=0.0, gaze_label_signs=(-1.0, -1.0))
    assert with_conventions(TWO, without_gaze) == replace(TWO, ray_offset=0.0), "it has no gaze label to mean anything"


def headnerf_file(folder: Path, **changes: Any) -> Path:
    """A HeadNeRF in the published layout, with the published code sizes."""
    config = FieldConfig(image_size=32, feature_size=16, feature_channels=24, hidden=32, **changes)
    field = make_field(replace(config, streams="one", gaze_input=False, eye_motion="none"))
    net = {name.replace("streams.head.", "fg_CD_predictor."): value for name, value in published_weights(field).items()}
    torch.save({"net": net, "para": {"num_sample_coarse": 12}}, folder / "headnerf.pth")
    return folder / "headnerf.pth"


def test_an_imported_headnerf_is_where_a_run_begins(toy_folder: Path, tmp_path: Path, capsys) -> None:
    """The whole way by commands: published file, import, two streams that start from it."""
    imported = tmp_path / "headnerf.safetensors"
    assert main(["import-checkpoint", str(headnerf_file(tmp_path)), "--out", str(imported)]) == 0
    field = {"image_size": 32, "feature_size": 16, "feature_channels": 24, "hidden": 32, "samples": 12}
    settings = ["steps=1", "batch=1", "learning_rate=1e-9", "final_learning_rate=1e-9", "perceptual=0", "functional=0"]
    words = ["--data", str(toy_folder), "--out", str(tmp_path / "run"), "--preset", "paper", "--device", "cpu"]
    begun = [*words, "--from", str(imported), "--set", *settings, f"field_overrides={json.dumps(field)}"]
    assert main(["train", *begun]) == 0
    said = capsys.readouterr().err
    assert len(said.strip().splitlines()) == 1 and "identity codes, 100 there and 4 here, is left out" in said
    found, known = load_field(tmp_path / "run" / "field.safetensors"), load_field(imported)
    assert (found.config.streams, found.config.eye_motion, found.config.ray_offset) == ("two", "feature_rotation", 0.0)
    assert found.config.gaze_label_signs == (1.0, 1.0)
    expected = known.state_dict()["streams.head.density.weight"]
    for stream in ("face", "eyes"):
        learned = found.state_dict()[f"streams.{stream}.density.weight"]
        torch.testing.assert_close(learned, expected, atol=1e-6, rtol=0.0)


def test_our_headnerf_is_where_a_gazenerf_begins(toy_folder: Path, tmp_path: Path) -> None:
    """`train --model headnerf`, then `train --from` its field, with the same preset."""
    field = make_field(replace(HEADNERF, gaze_input=True))
    save_field(field, tmp_path / "one.safetensors")
    words = ["--data", str(toy_folder), "--out", str(tmp_path / "run"), "--preset", "tiny", "--device", "cpu"]
    settings = ["steps=1", "eyeball=0", "learning_rate=1e-9", "final_learning_rate=1e-9", "ema=0"]
    assert main(["train", *words, "--from", str(tmp_path / "one.safetensors"), "--set", *settings]) == 0
    found = load_field(tmp_path / "run" / "field.safetensors")
    torch.testing.assert_close(found.stream("eyes").trunk[0].weight, field.stream("head").trunk[0].weight)
