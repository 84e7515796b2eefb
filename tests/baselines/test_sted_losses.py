"""STED's losses: zero where they should be, each switched by its weight, gradients for every weight."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from gazenerf.baselines.sted import Sted
from gazenerf.baselines.sted.config import PRESETS
from gazenerf.baselines.sted.critic import Critic
from gazenerf.baselines.sted.losses import (
    Judges,
    Labelled,
    Pass,
    critic_loss,
    degrees,
    forward,
    generator_losses,
    unlike,
)
from gazenerf.baselines.sted.network import GAZE, HEAD
from gazenerf.training.gaze_estimator import load_gaze_estimator

CONFIG = replace(PRESETS["tiny"], adversarial_warmup=10)
NAMES = {"l1", "labels", "consistency", "mixed_embeddings", "mixed_labels", "adversarial", "features", "directions"}


def labelled(seed: int) -> Labelled:
    generator = torch.Generator().manual_seed(seed)
    pictures = torch.rand(2, 3, 32, 32, generator=generator) * 2.0 - 1.0
    angles = [0.3 * torch.randn(2, 2, generator=generator) for _ in range(2)]
    return Labelled(pictures, *angles)


def flat_features(pictures: torch.Tensor) -> list[torch.Tensor]:
    return [pictures, torch.nn.functional.avg_pool2d(pictures, 4)]


def test_every_loss_is_there_and_together_they_reach_every_weight(tiny_sted: Sted) -> None:
    first, second = labelled(0), labelled(1)
    judges = Judges(flat_features, load_gaze_estimator())
    torch.manual_seed(2)
    found = forward(tiny_sted, first, second)
    config = replace(CONFIG, features=200.0)
    parts = generator_losses(found, first, second, Critic(4), judges, config, step=5)
    assert set(parts) == NAMES and all(float(part.detach()) > 0.0 for part in parts.values())
    torch.stack(list(parts.values())).sum().backward()
    for name, value in tiny_sted.named_parameters():
        assert value.grad is not None and value.grad.abs().max() > 0, name


@pytest.mark.parametrize("name", sorted(NAMES - {"l1"}))
def test_a_weight_of_zero_switches_a_loss_off(tiny_sted: Sted, name: str) -> None:
    first, second = labelled(0), labelled(1)
    config = replace(CONFIG, features=200.0)
    judges = Judges(flat_features, load_gaze_estimator())
    found = forward(tiny_sted, first, second)
    parts = generator_losses(found, first, second, Critic(4), judges, replace(config, **{name: 0.0}), step=5)
    assert set(parts) == NAMES - {name}


def test_what_is_right_costs_nothing(tiny_sted: Sted) -> None:
    first = labelled(0)
    factors = tiny_sted.encoder(first.pictures)
    true = Labelled(first.pictures, factors.angles[GAZE], factors.angles[HEAD])
    found = Pass(factors, factors, first.pictures, factors, factors)
    judges = Judges(flat_features, load_gaze_estimator())
    parts = generator_losses(found, true, true, Critic(4), judges, replace(CONFIG, features=200.0), step=0)
    for name, part in parts.items():
        assert float(part.detach()) == pytest.approx(0.0, abs=2e-3), name


def test_angles_are_degrees_between_directions() -> None:
    a, b = torch.tensor([[0.0, 0.0]]), torch.tensor([[0.0, torch.pi / 6]])
    assert degrees(a, b).item() == pytest.approx(30.0, abs=1e-3)
    assert degrees(torch.tensor([[0.0, 0.0, 1.0]]), torch.tensor([[0.0, 1.0, 0.0]])).item() == pytest.approx(90.0)


def test_factors_that_point_elsewhere_are_unlike(tiny_sted: Sted) -> None:
    a, b = (tiny_sted.encoder(labelled(seed).pictures) for seed in (0, 1))
    assert unlike(a, a).item() == pytest.approx(0.0, abs=1e-6) and unlike(a, b).item() > 1e-4


def test_the_critic_is_asked_little_at_first_and_learns_to_tell(tiny_sted: Sted) -> None:
    first, second = labelled(0), labelled(1)
    found = forward(tiny_sted, first, second)
    critic = Critic(4).eval()
    early, late, full = (
        float(generator_losses(found, first, second, critic, Judges(), CONFIG, step)["adversarial"].detach())
        for step in (1, 5, 100)
    )
    assert early == pytest.approx(0.1 * full) and late == pytest.approx(0.5 * full) and full > 0
    torch.manual_seed(0)
    critic = Critic(4)
    optimizer = torch.optim.Adam(critic.parameters(), lr=1e-2)
    losses = []
    for _ in range(15):
        optimizer.zero_grad()
        loss = critic_loss(critic, torch.zeros(2, 3, 32, 32), second.pictures, 1.0)
        loss.backward()
        optimizer.step()
        losses.append(float(loss.detach()))
    assert losses[-1] < 0.5 * losses[0]
