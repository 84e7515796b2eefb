"""Each loss alone: its value by hand, its gradient, its limits."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from gazenerf.geometry import Gaze
from gazenerf.training.losses import (
    angular_error,
    disentanglement_loss,
    functional_weight,
    gaze_loss,
    gaze_vectors,
    perceptual_loss,
    reconstruction_loss,
)


def test_reconstruction_counts_only_the_mask():
    image, target = torch.zeros(1, 3, 4, 4), torch.ones(1, 3, 4, 4)
    target[..., 2:, :] = 7.0
    mask = torch.zeros(1, 1, 4, 4, dtype=torch.bool)
    mask[..., :2, :] = True
    assert reconstruction_loss(image, target, mask).item() == pytest.approx(1.0)
    assert reconstruction_loss(image, target, ~mask).item() == pytest.approx(7.0)
    assert reconstruction_loss(image, target, ~mask, "l2").item() == pytest.approx(49.0)


def test_reconstruction_of_an_empty_mask_is_zero_with_a_gradient():
    image = torch.rand(1, 3, 4, 4, requires_grad=True)
    loss = reconstruction_loss(image, torch.rand(1, 3, 4, 4), torch.zeros(1, 1, 4, 4, dtype=torch.bool))
    loss.backward()
    assert loss.item() == 0.0
    assert image.grad is not None and float(image.grad.abs().max()) == 0.0


def test_perceptual_loss_sums_the_means_of_the_layers():
    def features(x: torch.Tensor) -> list[torch.Tensor]:
        return [2.0 * x, x[:, :1, ::2, ::2] + 5.0]

    image = torch.zeros(2, 3, 8, 8, requires_grad=True)
    loss = perceptual_loss(features, image, torch.full((2, 3, 8, 8), 0.5))
    assert loss.item() == pytest.approx(1.0 + 0.5)
    loss.backward()
    assert image.grad is not None and float(image.grad.abs().sum()) > 0


def test_gaze_vectors_agree_with_gaze():
    angles = np.deg2rad([[0, 0], [20, 0], [0, 30], [-15, -40]])
    wanted = np.stack([Gaze(*pair).vector() for pair in angles])
    np.testing.assert_allclose(gaze_vectors(torch.from_numpy(angles)).numpy(), wanted, atol=1e-12)


@pytest.mark.parametrize("degrees", [0.0, 1e-4, 5.0, 90.0, 179.999, 180.0])
def test_angular_error_is_the_angle_and_its_gradient_is_finite(degrees: float):
    angle = math.radians(degrees)
    a = torch.tensor([[0.0, 0.0, 1.0]], dtype=torch.float64, requires_grad=True)
    b = torch.tensor([[math.sin(angle), 0.0, math.cos(angle)]], dtype=torch.float64)
    error = angular_error(a, 3.0 * b)
    error.sum().backward()
    assert math.degrees(error.item()) == pytest.approx(degrees, abs=1e-3)
    assert a.grad is not None and bool(torch.isfinite(a.grad).all())


def test_gaze_loss_pulls_the_picture_and_not_the_target():
    def estimate(images: torch.Tensor) -> torch.Tensor:
        return images.mean((2, 3))[:, :2]

    image = torch.zeros(1, 3, 4, 4, requires_grad=True)
    target = torch.zeros(1, 3, 4, 4, requires_grad=True)
    with torch.no_grad():
        target[:, 1] = 0.3
    loss = gaze_loss(estimate, image, target)
    loss.backward()
    assert loss.item() == pytest.approx(0.3, abs=1e-5)
    assert target.grad is None
    assert image.grad is not None and float(image.grad[0, 1].sum()) < 0


def test_the_functional_weight_grows_each_epoch():
    assert [functional_weight(epoch) for epoch in range(3)] == pytest.approx([1e-3, 2e-3, 3e-3])


def test_disentanglement_weighs_each_code_over_its_length():
    codes = [torch.full((2, 4), 0.5), torch.full((2, 10), 2.0)]
    start = [torch.zeros(2, 4), torch.ones(2, 10)]
    assert disentanglement_loss(codes, start, (2.0, 3.0)).item() == pytest.approx(2.0 * 0.25 + 3.0 * 1.0)
    assert disentanglement_loss(start, start, (2.0, 3.0)).item() == 0.0
