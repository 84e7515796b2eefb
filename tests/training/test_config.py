"""Named presets have the shapes that their weights need."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from gazenerf.checkpoints import load_field
from gazenerf.field.config import PRESETS as FIELDS
from gazenerf.field.model import TwoStreamField
from gazenerf.training.config import PRESETS, TrainConfig

SIZES = {"identity": 100, "expression": 52, "texture": 36, "illumination": 27}
"""Of the synthetic head's codes."""


def test_portrait_has_the_shapes_of_a_512_px_field() -> None:
    with torch.device("meta"):
        field = TwoStreamField(replace(FIELDS["portrait"], **SIZES))
    shapes = {name: tuple(value.shape) for name, value in field.state_dict().items()}
    encoded = 3 + 6 * 8
    inputs = encoded + 100 + 52 + 2
    for stream in ("face", "eyes"):
        assert shapes[f"streams.{stream}.trunk.0.weight"] == (256, inputs)
        assert shapes[f"streams.{stream}.trunk.5.weight"] == (256, 256 + inputs)
        assert shapes[f"streams.{stream}.trunk.7.weight"] == (256, 256)
        assert shapes[f"streams.{stream}.feature_1.weight"] == (128, 256 + 36 + 27)
        assert shapes[f"streams.{stream}.feature_2.weight"] == (72, 128)
    assert shapes["renderer.background_features"] == (1, 72, 128, 128)
    assert shapes["renderer.upsample.1.widen_1.weight"] == (144, 72, 1, 1)
    assert "renderer.upsample.2.widen_0.weight" not in shapes, "128 to 512 px are two doublings"
    assert FIELDS["portrait"].image_size == 512


def test_the_bundled_portrait_is_of_this_preset() -> None:
    preset, bundled = replace(FIELDS["portrait"], **SIZES).to_dict(), load_field("portrait").config.to_dict()
    found_in_training = {"eyes_box", "trained_gaze_range"}
    of_densities = [name for name in preset if not name.startswith("distance_")]
    assert bundled["geometry"] == "density"
    assert {name for name in of_densities if preset[name] != bundled[name]} == found_in_training


def test_portrait_differs_from_small_in_size_only() -> None:
    changed = {name for name, value in FIELDS["portrait"].to_dict().items() if FIELDS["small"].to_dict()[name] != value}
    assert changed == {"image_size", "feature_size", "hidden"}
    portrait = PRESETS["portrait"]
    assert (portrait.perceptual_backbone, portrait.perceptual_stages, portrait.batch) == ("vgg16", 4, 10)


@pytest.mark.parametrize("stages", [0, 6])
def test_a_backbone_has_five_maps(stages: int) -> None:
    with pytest.raises(ValueError, match="1 to 5"):
        TrainConfig.from_dict({"perceptual_stages": stages})
