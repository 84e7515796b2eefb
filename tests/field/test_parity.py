"""The published networks' own inputs, weights and outputs (see the parity vectors' README)."""

from __future__ import annotations

import ast

import numpy as np
import pytest
import torch

from gazenerf.checkpoints import field_from_weights
from gazenerf.field.model import TwoStreamField
from gazenerf.field.published import config_from_weights, native_weights
from gazenerf.geometry import Camera, Gaze
from gazenerf.heads.head import Head
from gazenerf.subjects import Codes, Subject
from tests.field_doubles import parity_file

TOLERANCE = 1e-4
FILES = ("gazenerf_a.npz", "gazenerf_b.npz", "headnerf_a.npz")


def load(name: str) -> tuple[TwoStreamField, dict[str, torch.Tensor], dict[str, torch.Tensor]]:
    with np.load(parity_file(name), allow_pickle=False) as data:
        options = ast.literal_eval(str(data["config"]))
        tensors = {key: torch.from_numpy(data[key]) for key in data.files if key != "config"}
    state = {key.removeprefix("weights."): value for key, value in tensors.items() if key.startswith("weights.")}
    weights = native_weights(state)
    config = config_from_weights(
        {key: tuple(value.shape) for key, value in weights.items()},
        samples=options["num_sample_coarse"],
        z_near=options["world_z1"],
        z_far=options["world_z2"],
    )
    assert config.image_size == options["pred_img_size"]
    assert config.feature_size == options["featmap_size"]
    inputs = {key.removeprefix("in."): value for key, value in tensors.items() if key.startswith("in.")}
    outputs = {key.removeprefix("out."): value for key, value in tensors.items() if key.startswith("out.")}
    return field_from_weights(weights, config, name), inputs, outputs


@pytest.mark.parametrize("name", FILES)
def test_slow_path_gives_published_outputs(name: str) -> None:
    field, inputs, outputs = load(name)
    with torch.no_grad():
        found = field.published_forward(
            inputs["shape_code"],
            inputs["appearance_code"],
            inputs.get("gaze", torch.zeros(len(inputs["shape_code"]), 2)),
            inputs["c2w_rotation"],
            inputs["camera_position"],
            inputs["inv_intrinsics"],
        )
    assert len(outputs) >= 2
    for key, expected in outputs.items():
        assert found[key].shape == expected.shape, key
        assert (found[key] - expected).abs().max() < TOLERANCE, key


@pytest.mark.parametrize("name", FILES)
def test_fast_path_gives_published_pictures(name: str) -> None:
    field, inputs, outputs = load(name)
    config = field.config
    size = config.feature_size
    for i in range(len(inputs["shape_code"])):
        shape, look = inputs["shape_code"][i].numpy(), inputs["appearance_code"][i].numpy()
        codes = Codes(
            shape[: config.identity], shape[config.identity :], look[: config.texture], look[config.texture :]
        )
        label = inputs["gaze"][i] * torch.tensor(config.gaze_label_signs) if "gaze" in inputs else torch.zeros(2)
        intrinsics = np.linalg.inv(inputs["inv_intrinsics"][i].double().numpy())
        pose = np.eye(4)
        pose[:3, :3] = inputs["c2w_rotation"][i].double().numpy()
        pose[:3, 3:] = inputs["camera_position"][i].double().numpy()
        u, _, v = np.linalg.svd(pose[:3, :3])
        pose[:3, :3] = u @ v
        camera = Camera(
            intrinsics[0, 0], intrinsics[1, 1], intrinsics[0, 2], intrinsics[1, 2], size, size, pose
        ).resized(config.image_size)
        bound = Head(field, Subject("vector", codes)).at(Gaze(float(label[0]), float(label[1])))
        parts = ("head", "face", "eyes") if "image_face" in outputs else ("head",)
        images = bound.render(camera, parts).images
        for part in parts:
            expected = outputs["image" if part == "head" else f"image_{part}"][i].permute(1, 2, 0).numpy()
            assert np.abs(images[part] - expected).max() < TOLERANCE, part


def test_unknown_published_name_is_refused() -> None:
    with pytest.raises(KeyError):
        native_weights({"fg_CD_predictor_nose.density_module.weight": torch.zeros(1)})
