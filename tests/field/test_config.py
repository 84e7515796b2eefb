from __future__ import annotations

import json
from typing import Any

import pytest

from gazenerf.field.config import PRESETS, FieldConfig, ablations


@pytest.mark.parametrize("name", PRESETS)
def test_round_trip_through_json(name: str) -> None:
    config = PRESETS[name]
    assert FieldConfig.from_dict(json.loads(json.dumps(config.to_dict()))) == config
    ranged = FieldConfig.from_dict(config.to_dict() | {"trained_gaze_range": [25, 35]})
    assert ranged.trained_gaze_range == (25.0, 35.0)


def test_paper_preset_has_the_papers_sizes() -> None:
    config = PRESETS["paper"]
    assert (config.image_size, config.feature_size, config.feature_channels, config.hidden) == (512, 64, 258, 384)
    assert config.upsampling == 8 and config.input_channels("face") == 244 and config.code_sizes == (100, 79, 100, 27)
    assert PRESETS["headnerf"].input_channels("head") == 242


@pytest.mark.parametrize(
    "changes",
    [
        {"image_size": 500},
        {"image_size": 0},
        {"image_size": 32, "feature_size": 64},
        {"feature_channels": 257},
        {"hidden": 7},
        {"hidden": 10**9},
        {"layers": 5},
        {"z_near": -4.0},
        {"identity": -1},
        {"streams": "three"},
        {"merge": "min"},
        {"gaze_label_signs": (1.0, 0.5)},
        {"sampler": 3},
        {"colour": "red"},
        {"hidden": "wide"},
        {"samples": None},
    ],
)
def test_impossible_values_are_refused(changes: dict[str, Any]) -> None:
    with pytest.raises((ValueError, TypeError)):
        FieldConfig.from_dict(FieldConfig().to_dict() | changes)


def test_ablations_differ_in_streams_and_rotation_only() -> None:
    base = PRESETS["tiny"]
    found = {name: (config.streams, config.eye_motion) for name, config in ablations(base).items()}
    assert found == {
        "vanilla": ("one", "none"),
        "vanilla+rotation": ("one", "feature_rotation"),
        "two-stream": ("two", "none"),
        "two-stream+rotation": ("two", "feature_rotation"),
    }
    for config in ablations(base).values():
        same = config.to_dict() | {"streams": base.streams, "eye_motion": base.eye_motion}
        assert same == base.to_dict()
