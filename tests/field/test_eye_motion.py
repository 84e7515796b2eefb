from __future__ import annotations

import numpy as np
import torch

from gazenerf.field.eye_motion import gaze_rotation, keep_features, rotate_features
from gazenerf.geometry.gaze import rotation_x, rotation_y

LABEL = torch.tensor([[0.3, -0.5], [-0.2, 0.1]])


def test_rotation_is_yaw_after_pitch() -> None:
    for label, rotation in zip(LABEL, gaze_rotation(LABEL), strict=True):
        expected = rotation_y(float(label[1])) @ rotation_x(float(label[0]))
        np.testing.assert_allclose(rotation.numpy(), expected, atol=1e-6)


def test_groups_of_three_are_row_vectors() -> None:
    features = torch.randn(2, 5, 258, generator=torch.Generator().manual_seed(0))
    turned = rotate_features(features, LABEL[:, None])
    rotation = gaze_rotation(LABEL)
    for group in (0, 1, 85):
        rows = features[..., 3 * group : 3 * group + 3]
        assert torch.allclose(turned[..., 3 * group : 3 * group + 3], rows @ rotation, atol=1e-5)


def test_rotation_keeps_lengths_and_nothing_else_does() -> None:
    features = torch.randn(2, 30)
    turned = rotate_features(features, LABEL)
    lengths = features.unflatten(-1, (-1, 3)).norm(dim=-1)
    assert torch.allclose(turned.unflatten(-1, (-1, 3)).norm(dim=-1), lengths, atol=1e-5)
    assert not torch.allclose(turned, features, atol=1e-2)
    assert torch.allclose(rotate_features(features, torch.zeros(2, 2)), features, atol=1e-6)
    assert keep_features(features, LABEL) is features
