"""A training batch shows what the published pass shows, and learns from it the same way."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from gazenerf.field.config import PRESETS
from gazenerf.field.model import TwoStreamField
from gazenerf.training.batches import Batch, BatchMaker
from gazenerf.training.forward import render_batch

SIZES = {"identity": 4, "expression": 3, "texture": 5, "illumination": 27}


def varied_field(**changes: Any) -> TwoStreamField:
    """Random weights whose densities hide something but not everything."""
    torch.manual_seed(3)
    field = TwoStreamField(replace(PRESETS["tiny"], image_size=32, feature_size=16, samples=12, **SIZES, **changes))
    with torch.no_grad():
        for name, value in field.named_parameters():
            if name.endswith("bias") or name == "renderer.background_features":
                value += 0.3 * torch.randn_like(value)
        for name in field.streams:
            field.stream(name).density.weight *= 0.3
            field.stream(name).density.bias.fill_(-5.0 if field.config.density_activation == "softplus" else 0.2)
    return field


def published(field: TwoStreamField, batch: Batch, captures: list[Any]) -> dict[str, torch.Tensor]:
    """The published pass for the batch's captures."""
    cameras = [captures[int(i)].camera.resized(field.config.feature_size) for i in batch.index]

    def stacked(arrays: list[np.ndarray]) -> torch.Tensor:
        return torch.from_numpy(np.stack(arrays).astype(np.float32))

    return field.published_forward(
        batch.shape_code,
        batch.appearance_code,
        field.label(batch.gaze),
        stacked([camera.world_from_camera[:3, :3] for camera in cameras]),
        stacked([camera.world_from_camera[:3, 3:] for camera in cameras]),
        stacked([np.linalg.inv(camera.intrinsics) for camera in cameras]),
    )


@pytest.mark.parametrize(
    "changes", [{"merge": "joint"}, {"merge": "max"}, {"streams": "one"}, {"merge": "joint", "eye_motion": "none"}]
)
def test_a_batchs_pictures_and_gradients_are_the_published_passs(toy_captures, changes: dict[str, Any]) -> None:
    field = varied_field(**changes)
    two = field.config.streams == "two"
    maker = BatchMaker(toy_captures, 16, ray_offset=field.config.ray_offset, all_rays=True)
    batch = maker.batch([0, 9], np.random.default_rng(0))
    weights = torch.randn(2, 3, 32, 32, generator=torch.Generator().manual_seed(1))

    def gradients(images: list[torch.Tensor]) -> dict[str, torch.Tensor]:
        field.zero_grad()
        torch.stack([(weights * image).sum() for image in images]).sum().backward()
        return {name: value.grad.clone() for name, value in field.named_parameters() if value.grad is not None}

    render = render_batch(field, batch, shell=None, samples=0, jitter=False, geometry=False, face_image=two)
    expected = published(field, batch, toy_captures)
    assert expected["image"].std() > 0.02
    share = expected["background_alpha_face" if two else "background_alpha_head"].mean()
    assert 0.05 < share.item() < 0.95, "some light passes, some does not"
    assert (render.image - expected["image"]).abs().max() < 1e-4
    ours, theirs = [render.image], [expected["image"]]
    if two:
        assert render.face_image is not None and (render.face_image - expected["image_face"]).abs().max() < 1e-4
        ours.append(render.face_image)
        theirs.append(expected["image_face"])
    found, wanted = gradients(ours), gradients(theirs)
    assert found.keys() == wanted.keys() and len(found) > 20
    for name, value in wanted.items():
        scale = float(value.abs().max())
        assert scale > 0, name
        # points differ by rounding, which the highest encoding frequency and the corners of ReLU multiply
        assert float((found[name] - value).abs().max()) < 0.02 * scale, name
        assert float(torch.cosine_similarity(found[name].flatten(), value.flatten(), dim=0)) > 0.9999, name


def test_samples_around_the_surface_are_another_picture(toy_captures) -> None:
    """The comparison above can fail: other samples of the same field differ by more than its tolerance."""
    field = varied_field(merge="joint")
    batch = BatchMaker(toy_captures, 16, all_rays=True).batch([0], np.random.default_rng(0))
    shell = render_batch(field, batch, shell=0.1, samples=6, jitter=False, geometry=False).image
    assert (shell - published(field, batch, toy_captures)["image"]).abs().max() > 1e-2
