"""Features that move from points in space to places on the template."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from gazenerf.errors import UserError
from gazenerf.field.config import PRESETS
from gazenerf.field.model import TwoStreamField
from gazenerf.head_model import load_head_model
from gazenerf.training import template_features
from gazenerf.training.template_features import STATE, FeatureOptions, move_features, on_template


@pytest.fixture(scope="module")
def field() -> TwoStreamField:
    """Small, with random distances whose moves are large enough to matter."""
    identity, expression, texture, illumination = load_head_model().code_sizes
    sizes = {"identity": identity, "expression": expression, "texture": texture, "illumination": illumination}
    torch.manual_seed(0)
    config = replace(
        PRESETS["tiny"], geometry="distance", distance_width=16, distance_frequencies=3, distance_template=8,
        trained_gaze_range=(20.0, 30.0), **sizes,
    )  # fmt: skip
    made = TwoStreamField(config).eval()
    with torch.no_grad():
        for name in made.streams:
            made.stream(name).distance.move.matrix.weight.mul_(3.0)  # type: ignore[union-attr]
    return made


@pytest.fixture(autouse=True)
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(template_features, "CHECKED", 2)
    monkeypatch.setattr(template_features, "CHECK_POINTS", 60)
    monkeypatch.setattr(template_features, "POINTS", {"face": 64, "eyes": 32})


def same(one: TwoStreamField, other: TwoStreamField, only: str = "") -> bool:
    theirs = other.state_dict()
    return all(torch.equal(value, theirs[name]) for name, value in one.state_dict().items() if only in name)


def test_features_come_nearer_to_what_they_were_and_distances_stay(
    field: TwoStreamField, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(template_features, "CHECK_SEED", 3)  # random weights mean nothing for people not learned from
    before = move_features(field, FeatureOptions(0, 2, seed=3), tmp_path)[1]
    moved, after = move_features(field, FeatureOptions(60, 2, learning_rate=2e-3, seed=3), tmp_path)
    assert moved.config.features_at == "template" and field.config.features_at == "points"
    assert before["face"] > 0.05 and after["face"] < 0.9 * before["face"] and after["eyes"] < before["eyes"]
    assert same(moved, field, ".distance.") and same(moved, field, "renderer.") and not same(moved, field)


def test_another_field_learns_the_features_and_keeps_its_distances(
    field: TwoStreamField, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(template_features, "CHECK_SEED", 3)
    torch.manual_seed(1)
    onto = on_template(TwoStreamField(field.config).eval())
    taught = on_template(field)
    before = move_features(taught, FeatureOptions(0, 2, seed=3), tmp_path, onto=onto)[1]
    moved, after = move_features(taught, FeatureOptions(60, 2, learning_rate=2e-3, seed=3), tmp_path, onto=onto)
    assert after["face"] < 0.8 * before["face"] and after["eyes"] < 0.8 * before["eyes"]
    assert same(moved, onto, ".distance.") and not same(moved, field, ".distance.")
    with pytest.raises(UserError, match="hidden"):
        other = TwoStreamField(replace(field.config, hidden=2 * field.config.hidden))
        move_features(field, FeatureOptions(1, 1), tmp_path, onto=other)


def test_a_run_that_stopped_goes_on_as_if_it_had_not(field: TwoStreamField, tmp_path: Path) -> None:
    whole = move_features(field, FeatureOptions(4, 2), tmp_path / "whole")[0]
    state = torch.load(tmp_path / "whole" / STATE, weights_only=True)
    stopped = move_features(field, FeatureOptions(4, 2), tmp_path / "parts", save_every=2)[0]
    assert state["step"] == 4 and same(whole, stopped)
    resumed = move_features(field, FeatureOptions(4, 2), tmp_path / "whole", resume=True)[0]
    assert same(whole, resumed)


def test_only_fields_of_distances_with_features_at_points_are_taken(field: TwoStreamField, tmp_path: Path) -> None:
    for other in (on_template(field), TwoStreamField(replace(PRESETS["tiny"], trained_gaze_range=(20.0, 30.0)))):
        with pytest.raises(UserError, match="a field of distances with features at points"):
            move_features(other, FeatureOptions(1, 1), tmp_path)
    (tmp_path / STATE).write_bytes(b"not a state")
    with pytest.raises(UserError):
        move_features(field, FeatureOptions(1, 1), tmp_path, resume=True)
