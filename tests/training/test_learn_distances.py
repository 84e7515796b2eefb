"""The script that gives a field of densities surfaces of distances."""

from __future__ import annotations

import runpy
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from gazenerf.checkpoints import load_field, save_field
from gazenerf.errors import UserError
from gazenerf.field.config import PRESETS
from gazenerf.field.model import TwoStreamField
from gazenerf.head_model import load_head_model
from gazenerf.training import distances

SCRIPT = Path(__file__).parents[2] / "scripts" / "learn_distances.py"


def test_features_stay_and_known_distances_are_learned_further(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(distances, "CHECKED", 1)
    main = runpy.run_path(str(SCRIPT))["main"]

    def learn(out: Path, checkpoint: Path) -> None:
        words = ["--checkpoint", checkpoint, "--out", out, "--steps", 4, "--people", 1]
        monkeypatch.setattr(sys, "argv", ["learn_distances.py", *map(str, words)])
        main()

    identity, expression, texture, illumination = load_head_model().code_sizes
    sizes = {"identity": identity, "expression": expression, "texture": texture, "illumination": illumination}
    torch.manual_seed(0)
    before = TwoStreamField(replace(PRESETS["tiny"], trained_gaze_range=(20.0, 30.0), **sizes))
    save_field(before, tmp_path / "densities.safetensors")
    learn(tmp_path / "run", tmp_path / "densities.safetensors")
    found = load_field(tmp_path / "run" / "field.safetensors")
    assert found.config.geometry == "distance" and found.about["geometry"]["steps"] == 4
    for name, value in before.state_dict().items():
        if ".density." not in name:
            torch.testing.assert_close(found.state_dict()[name], value)
    learn(tmp_path / "again", tmp_path / "run" / "field.safetensors")
    again = load_field(tmp_path / "again" / "field.safetensors")
    assert again.about["geometry"]["steps"] == 8 and again.config == found.config
    moved = [name for name, value in found.state_dict().items() if not torch.equal(value, again.state_dict()[name])]
    assert moved and all(".distance." in name for name in moved)
    save_field(TwoStreamField(replace(PRESETS["tiny"], **sizes)), tmp_path / "range.safetensors")
    with pytest.raises(UserError, match="trained gaze range"):
        learn(tmp_path / "none", tmp_path / "range.safetensors")
    assert not (tmp_path / "none").exists()
