from __future__ import annotations

import numpy as np
import pytest
import torch

from gazenerf.field.config import FieldConfig, ablations
from gazenerf.field.model import TwoStreamField
from gazenerf.geometry import Camera
from tests.field_doubles import make_field, tiny_config

NAMES = ("vanilla", "vanilla+rotation", "two-stream", "two-stream+rotation")


def reference(field: TwoStreamField, label: torch.Tensor) -> dict[str, torch.Tensor]:
    config = field.config
    generator = torch.Generator().manual_seed(5)
    camera = Camera.neutral(config.feature_size)
    pose = torch.from_numpy(camera.world_from_camera.astype(np.float32))[None].expand(len(label), -1, -1)
    return field.published_forward(
        torch.randn(len(label), config.identity + config.expression, generator=generator),
        torch.randn(len(label), config.texture + config.illumination, generator=generator),
        label,
        pose[:, :3, :3],
        pose[:, :3, 3:],
        torch.from_numpy(np.linalg.inv(camera.intrinsics).astype(np.float32))[None].expand(len(label), -1, -1),
    )


def ablation(name: str, merge: str = "max") -> FieldConfig:
    return ablations(tiny_config(merge=merge, samples=8))[name]


@pytest.mark.parametrize("merge", ["max", "joint"])
@pytest.mark.parametrize("name", NAMES)
def test_ablation_has_its_streams_and_gradients_reach_every_weight(name: str, merge: str) -> None:
    config = ablation(name, merge)
    torch.manual_seed(0)
    field = TwoStreamField(config)
    assert set(field.streams) == ({"head"} if name.startswith("vanilla") else {"face", "eyes"})
    found = reference(field, torch.tensor([[0.1, 0.2], [-0.3, 0.1]]))
    assert found["image"].shape == (2, 3, config.image_size, config.image_size)
    assert ("image_eyes" in found) == (config.streams == "two")
    found["image"].square().mean().backward()
    for key, value in field.named_parameters():
        assert value.grad is not None and bool(value.grad.isfinite().all()), key
        if key != "renderer.background_features":  # hidden where everything is opaque
            assert value.grad.abs().max() > 0, key


@pytest.mark.parametrize("name", NAMES)
def test_rotation_acts_on_the_configured_features_only(name: str) -> None:
    config = FieldConfig.from_dict(ablation(name).to_dict() | {"gaze_input": False})
    field = make_field(config)
    with torch.no_grad():
        still, turned = (reference(field, torch.tensor([label])) for label in ([0.0, 0.0], [0.4, -0.5]))
    moves = {key for key in still if not torch.allclose(still[key], turned[key], atol=1e-5)}
    assert (
        moves
        == {
            "vanilla": set(),
            "vanilla+rotation": {"image"},
            "two-stream": set(),
            "two-stream+rotation": {"image", "image_eyes"},
        }[name]
    )


def test_fresh_streams_are_dense_somewhere_and_finite() -> None:
    torch.manual_seed(0)
    field = TwoStreamField(tiny_config())
    with torch.no_grad():
        found = reference(field, torch.zeros(1, 2))
    for name in ("face", "eyes"):
        density = found[f"density_{name}"]
        assert bool(density.isfinite().all()) and (density > 0).float().mean() > 0.3
    image = found["image"]
    assert image.std() > 0.01 and bool(image.isfinite().all())


def test_label_signs_turn_native_gaze_into_the_streams_label() -> None:
    field = make_field(tiny_config(gaze_label_signs=(-1.0, -1.0)))
    assert field.label(torch.tensor([0.1, 0.2])).tolist() == pytest.approx([-0.1, -0.2])


def test_joint_merge_of_an_empty_eye_stream_is_the_face() -> None:
    field = make_field(tiny_config(merge="joint", samples=8))
    field.stream("eyes").density.weight.zero_()
    field.stream("eyes").density.bias.fill_(-40.0)  # softplus leaves 4e-18 there
    with torch.no_grad():
        found = reference(field, torch.tensor([[0.2, 0.1]]))
    assert torch.allclose(found["image"], found["image_face"], atol=1e-5)
