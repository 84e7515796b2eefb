"""Geometry is learned from points, before pictures, and held."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from gazenerf.checkpoints import load_field
from gazenerf.data.captures import Capture
from gazenerf.errors import UserError
from gazenerf.field.config import PRESETS as FIELDS
from gazenerf.field.model import TwoStreamField
from gazenerf.head_model import load_head_model
from gazenerf.subjects import Codes
from gazenerf.training import distances as distances_module
from gazenerf.training.config import PRESETS
from gazenerf.training.distances import DistanceOptions, draw_points, learn_distances, measure_distances
from gazenerf.training.initial import starting_field
from gazenerf.training.loop import train
from gazenerf.training.runtime import Runtime

SIZES = load_head_model().code_sizes
FIELD = replace(
    FIELDS["tiny"], identity=SIZES[0], expression=SIZES[1], texture=SIZES[2], illumination=SIZES[3],
    geometry="distance", distance_width=48, distance_frequencies=4, distance_template=32,
)  # fmt: skip
OPTIONS = DistanceOptions(steps=120, people=2, learning_rate=3e-3, trained=(20.0, 30.0))


def fresh_field() -> TwoStreamField:
    torch.manual_seed(0)
    return TwoStreamField(FIELD)


@pytest.fixture(autouse=True)
def few_people_are_checked(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(distances_module, "CHECKED", 1)


@pytest.mark.parametrize("part", ["face", "eyes"])
def test_a_move_with_finer_octaves_begins_as_the_same_function(part: str) -> None:
    coarse = fresh_field()
    fine = starting_field(replace(FIELD, template_frequencies=7, template_fall=1.4), coarse)
    draw = torch.Generator().manual_seed(1)
    points = torch.rand(1, 200, 3, generator=draw) - 0.5
    codes = torch.randn(1, FIELD.identity + FIELD.expression, generator=draw)
    gaze = torch.tensor([[0.2, -0.3]])

    def places(field: TwoStreamField) -> torch.Tensor:
        network = distances_module.distance_network(field, part)
        return network.places(points, network.condition(codes, gaze))

    assert (places(coarse) - points).abs().max() > 1e-3
    torch.testing.assert_close(places(fine), places(coarse), rtol=0.0, atol=1e-6)
    with pytest.raises(UserError, match="template_frequencies 7"):
        starting_field(FIELD, fine)


def test_surfaces_come_nearer_to_peoples(tmp_path: Path) -> None:
    field = fresh_field()
    # those that are learned from: two say nothing of others
    points = draw_points(field, OPTIONS.trained, 2, OPTIONS.seed)
    before = {part: measure_distances(field, part, points[part]) for part in points}
    found = learn_distances(field, replace(OPTIONS, steps=300), tmp_path, save_every=100)
    after = {part: measure_distances(field, part, points[part]) for part in points}
    for part, most in (("face", 7.0), ("eyes", 0.8)):
        assert after[part]["median_mm"] < min(most, 0.6 * before[part]["median_mm"]), part
        assert after[part]["normals_deg"] < before[part]["normals_deg"], part
    assert after["face"]["places_mm"] < 0.96 * before["face"]["places_mm"]
    assert found["eyes"]["median_mm"] < 2.5 and found["face"]["normals_deg"] < 50.0
    rows = [json.loads(line) for line in (tmp_path / "distances.jsonl").read_text().splitlines()]
    # places alone are learned for the first 120 steps
    assert [row["step"] for row in rows] == [100, 200, 300] and rows[2]["loss"] < rows[1]["loss"]


def test_known_distances_are_learned_further_from_where_they_are(tmp_path: Path) -> None:
    field = fresh_field()
    learn_distances(field, OPTIONS, tmp_path / "first", save_every=200)
    balls = {part: distances_module.distance_network(field, part).balls.clone() for part in distances_module.PARTS}
    further = replace(OPTIONS, steps=1, learning_rate=1e-9, seed=2, further=True)
    before = {name: value.clone() for name, value in field.state_dict().items()}
    field.requires_grad_(False)  # as a field is that was read from a file
    learn_distances(field, further, tmp_path / "second")
    for name, value in field.state_dict().items():
        torch.testing.assert_close(value, before[name], atol=1e-7, rtol=0.0)
    for part, ball in balls.items():
        assert torch.equal(distances_module.distance_network(field, part).balls, ball)
        assert distances_module.distance_network(field, part).last.weight.requires_grad


def test_a_killed_run_goes_on_to_the_same_distances(tmp_path: Path) -> None:
    whole, parts = fresh_field(), fresh_field()
    options = replace(OPTIONS, steps=12)
    learn_distances(whole, options, tmp_path / "whole", save_every=6)

    class Killed(Exception):
        pass

    def kill(stage: str, done: int, total: int) -> None:
        if stage.startswith("geometry") and done == 9:
            raise Killed

    with pytest.raises(Killed):
        learn_distances(parts, options, tmp_path / "parts", save_every=6, progress=kill)
    resumed = fresh_field()
    learn_distances(resumed, options, tmp_path / "parts", resume=True, save_every=6)
    again = fresh_field()
    learn_distances(again, options, tmp_path / "parts", resume=True)  # all steps are made
    for name, value in whole.state_dict().items():
        torch.testing.assert_close(resumed.state_dict()[name], value)
        torch.testing.assert_close(again.state_dict()[name], value)
    rows = [json.loads(line)["step"] for line in (tmp_path / "parts" / "distances.jsonl").read_text().splitlines()]
    assert rows == [6, 12]


def test_rigid_eyes_are_learned_looking_straight_ahead() -> None:
    torch.manual_seed(0)
    turned = draw_points(fresh_field(), OPTIONS.trained, 2, 5)["eyes"]
    rigid = draw_points(TwoStreamField(replace(FIELD, eye_motion="rigid")), OPTIONS.trained, 2, 5)["eyes"]
    iris = [points.surface[0][points.surface[0, :, 0] > 0][:, 2].max() for points in (turned, rigid)]
    assert rigid.gaze[0].abs().max() > 0.05 and iris[1] > iris[0]  # the cornea bulges forward where the eye looks


@pytest.fixture
def captures(toy_captures: list[Capture]) -> list[Capture]:
    """Toy captures of people whose codes are the head model's."""
    codes = Codes(*(np.zeros(size, np.float32) for size in SIZES))
    return [replace(capture, codes=codes) for capture in toy_captures]


def test_training_holds_the_distances_that_it_has_learned(
    captures: list[Capture], tmp_path: Path, toy_eyeballs
) -> None:
    config = replace(PRESETS["tiny"], steps=3, geometry_steps=10, geometry_people=2)
    stages: list[str] = []
    options = {"eyeballs": toy_eyeballs, "runtime": Runtime("cpu", precision="float32")}
    train(captures, FIELD, config, tmp_path / "a", progress=lambda stage, done, total: stages.append(stage), **options)
    assert stages[0] == "points about people" and stages[-1].startswith("geometry, loss")
    field = load_field(tmp_path / "a" / "field.safetensors")
    state = torch.load(tmp_path / "a" / "distances.pt", weights_only=True)
    for part in ("face", "eyes"):
        network = field.stream(part).distance
        assert network is not None
        for name, value in network.state_dict().items():
            torch.testing.assert_close(value, state["networks"][part][name])
    assert field.about["geometry"]["unseen_people"]["face"]["median_mm"] > 0.0

    # another field may begin with them, without learning any
    began = replace(config, steps=1, geometry_steps=0)
    train(captures, FIELD, began, tmp_path / "b", initial=field, **options)
    other = load_field(tmp_path / "b" / "field.safetensors")
    assert other.about["geometry"] == field.about["geometry"] and not (tmp_path / "b" / "distances.pt").exists()
    with pytest.raises(UserError, match="distances have to be learned: give --set geometry_steps above 0"):
        train(captures, FIELD, began, tmp_path / "c", **options)


def test_features_of_a_field_of_densities_go_on_on_distances() -> None:
    torch.manual_seed(1)
    densities = TwoStreamField(replace(FIELD, geometry="density"))
    field = starting_field(FIELD, densities)
    for name, value in densities.state_dict().items():
        if ".density." not in name:
            torch.testing.assert_close(field.state_dict()[name], value)
    with pytest.raises(UserError, match='geometry "distance" where it needs "density"'):
        starting_field(densities.config, field)


def test_people_of_another_head_model_are_one_line(tmp_path: Path) -> None:
    field = TwoStreamField(replace(FIELD, identity=4, expression=3))
    with pytest.raises(UserError, match=r"codes \(100, 52\) are not the field's \(4, 3\); choose geometry density"):
        learn_distances(field, OPTIONS, tmp_path)
