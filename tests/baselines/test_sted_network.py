"""The networks have the published shapes, and factors turn as rotations do."""

from __future__ import annotations

from typing import Any

import pytest
import torch

from gazenerf.baselines.sted import Sted, StedConfig
from gazenerf.baselines.sted.config import from_dict, to_dict
from gazenerf.baselines.sted.critic import Critic
from gazenerf.baselines.sted.network import GAZE, HEAD, rotation
from tests.baselines.conftest import TINY


@pytest.mark.parametrize(("size", "blocks"), [(128, 5), (512, 7)])
def test_pictures_come_down_to_two_pixels_and_back(size: int, blocks: int) -> None:
    config = StedConfig(image_size=size)
    assert config.blocks == blocks
    with torch.device("meta"):
        model = Sted(config)
        pictures = torch.empty(2, 3, size, size)
    assert model.encoder.maps(pictures).shape[-2:] == (2, 2)
    factors = model.encoder(pictures)
    assert factors.appearance.shape == (2, 1024) and factors.flat.shape == (2, 1024 + 4 * 16 * 2 + 4 * 16 * 3)
    assert [angle.shape[1] for angle in factors.angles] == [1] * 4 + [2] * 4
    assert model.decode(factors).shape == pictures.shape


def test_the_critic_looks_at_patches() -> None:
    with torch.device("meta"):
        assert Critic()(torch.empty(2, 3, 128, 128)).shape == (2, 1, 14, 14)


def test_rotations_keep_lengths_and_undo_themselves() -> None:
    torch.manual_seed(1)
    for angles in (torch.randn(5, 1), torch.randn(5, 2)):
        found = rotation(angles)
        torch.testing.assert_close(found @ found.transpose(1, 2), torch.eye(found.shape[-1]).expand_as(found))
    quarter = rotation(torch.tensor([[torch.pi / 2]]))[0]
    torch.testing.assert_close(quarter @ torch.tensor([1.0, 0.0]), torch.tensor([0.0, 1.0]), atol=1e-6, rtol=0.0)


def test_turning_to_the_pictures_own_angles_changes_nothing(tiny_sted: Sted) -> None:
    pictures = torch.rand(2, 3, 32, 32) * 2.0 - 1.0
    factors = tiny_sted.encoder(pictures)
    own = tiny_sted.redirect(pictures, factors.angles[GAZE], factors.angles[HEAD])
    torch.testing.assert_close(own, tiny_sted.decode(factors), atol=1e-5, rtol=1e-4)
    there = factors.straight().turned(factors.angles)
    for found, expected in zip(there.embeddings, factors.embeddings, strict=True):
        torch.testing.assert_close(found, expected, atol=1e-5, rtol=1e-4)


def test_another_gaze_moves_the_embedding_of_the_gaze_alone(tiny_sted: Sted) -> None:
    pictures = torch.rand(2, 3, 32, 32) * 2.0 - 1.0
    factors = tiny_sted.encoder(pictures)
    moved = factors.towards(torch.tensor([[0.3, -0.4]]).expand(2, -1), factors.angles[HEAD])
    changed = [not torch.allclose(a, b, atol=1e-5) for a, b in zip(moved.embeddings, factors.embeddings, strict=True)]
    assert changed == [False, False, False, True]
    torch.testing.assert_close(moved.embeddings[GAZE].norm(dim=1), factors.embeddings[GAZE].norm(dim=1))
    made, before = tiny_sted.decode(moved), tiny_sted.decode(factors)
    assert (made - before).abs().max() > 1e-4


def test_settings_survive_json_and_impossible_ones_are_refused() -> None:
    assert from_dict(StedConfig, to_dict(TINY)) == TINY


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"image_size": 100}, "power of two"),
        ({"image_size": 4096}, "16 to 1024"),
        ({"growth": 0}, "1 to 128"),
        ({"growth": True}, "growth is a int"),
        ({"two_d": 1}, "2 to 64"),
        ({"appearance": 10**9}, "1 to 8192"),
        ({"depth": 3}, "unknown settings: depth"),
        ({"width": "wide"}, "width is a int"),
    ],
)
def test_impossible_sizes_are_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        from_dict(StedConfig, to_dict(TINY) | change)
