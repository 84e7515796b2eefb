from __future__ import annotations

import math

import pytest
import torch

from gazenerf.field.compositing import composite, composite_joint


def test_two_samples_by_hand() -> None:
    weights, opacity = composite(torch.tensor([1.0, 2.0]), torch.tensor([0.5, 0.25]))
    first = 1 - math.exp(-0.5)
    second = math.exp(-0.5) * (1 - math.exp(-0.5))
    assert weights.tolist() == pytest.approx([first, second])
    assert opacity.item() == pytest.approx(first + second)


def test_constant_medium_follows_beer_lambert() -> None:
    _, opacity = composite(torch.full((3, 50), 0.7), torch.full((3, 50), 0.04))
    assert opacity.tolist() == pytest.approx([1 - math.exp(-0.7 * 2.0)] * 3, abs=1e-5)


def test_joint_medium_of_one_stream_is_that_stream() -> None:
    torch.manual_seed(0)
    density, deltas = torch.rand(4, 8) * 5, torch.rand(4, 8)
    alone, opacity = composite(density, deltas)
    face, eyes, joint = composite_joint(density, torch.zeros_like(density), deltas)
    assert torch.allclose(face, alone) and torch.allclose(joint, opacity)
    assert eyes.abs().max() == 0.0
    _, eyes, _ = composite_joint(torch.zeros_like(density), density, deltas)
    assert torch.allclose(eyes, alone)


def test_joint_weights_add_up_and_split_by_density() -> None:
    torch.manual_seed(0)
    a, b, deltas = torch.rand(4, 8) * 5, torch.rand(4, 8) * 5, torch.rand(4, 8)
    face, eyes, opacity = composite_joint(a, b, deltas)
    assert torch.allclose((face + eyes).sum(-1), opacity)
    assert torch.allclose(face * b, eyes * a, atol=1e-6)


def test_lid_in_front_hides_the_eye() -> None:
    lid, eye, deltas = torch.tensor([0.0, 100.0, 0.0]), torch.tensor([0.0, 0.0, 100.0]), torch.full((3,), 0.2)
    _, eyes, _ = composite_joint(lid, eye, deltas)
    assert eyes.sum() < 1e-6
    assert composite(eye, deltas)[1] > 0.99


def test_opaque_samples_keep_gradients_finite() -> None:
    density = torch.full((2, 6), 1e6, requires_grad=True)
    weights, _ = composite(density, torch.ones(2, 6))
    weights.square().sum().backward()
    assert density.grad is not None and bool(density.grad.isfinite().all())
