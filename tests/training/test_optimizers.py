"""Which optimiser moves which weights, and that a state goes only where it came from."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from gazenerf.field.config import PRESETS
from gazenerf.field.model import TwoStreamField
from gazenerf.training.muon import BatchedMuon
from gazenerf.training.optimizers import Optimizers, is_hidden


def parameters() -> dict[str, torch.nn.Parameter]:
    torch.manual_seed(0)
    return dict(TwoStreamField(replace(PRESETS["tiny"], identity=4, expression=3, texture=5)).named_parameters())


def test_every_weight_has_one_optimiser_and_hidden_matrices_have_muon():
    named = parameters()
    for kind, members in (("adam", 1), ("muon", 2)):
        optimizers = Optimizers(named, kind, 1e-3)
        held = [id(p) for member in optimizers.members for group in member.param_groups for p in group["params"]]
        assert len(optimizers.members) == members
        assert sorted(held) == sorted(id(p) for p in named.values())
    turned = {id(p) for group in optimizers.members[1].param_groups for p in group["params"]}
    names = [name for name, value in named.items() if id(value) in turned]
    assert len(names) == 2 * (7 + 2), "seven trunk layers after the first and two feature layers a stream"
    assert not any("renderer" in name or "density" in name or "trunk.0." in name for name in names)


def test_rates_follow_their_scales():
    optimizers = Optimizers(parameters(), "muon", 1e-3, density_scale=3.0, muon_scale=1.5)
    optimizers.set_rate(0.01)
    rates = [group["lr"] for member in optimizers.members for group in member.param_groups]
    assert rates == pytest.approx([0.01, 0.03, 0.015])


def test_a_muon_step_moves_all_directions_alike_where_adam_would_not():
    named = parameters()
    name = next(name for name, value in named.items() if is_hidden(name, value))
    weight = named[name]
    before = weight.detach().clone()
    spread = torch.logspace(0, -2, min(weight.shape))
    left = torch.linalg.qr(torch.randn(weight.shape[0], len(spread)))[0]
    right = torch.linalg.qr(torch.randn(weight.shape[1], len(spread)))[0]
    weight.grad = left @ torch.diag(spread) @ right.T
    optimizers = Optimizers({name: weight}, "muon", 1e-3)
    optimizers.set_rate(1e-3)
    optimizers.step()
    moved = torch.linalg.svdvals(weight.detach() - before)
    assert moved[0] / moved[len(spread) // 2] < 2.0, "the gradient's own ratio there is 10"


def test_a_state_of_other_optimisers_is_refused():
    adam, muon = Optimizers(parameters(), "adam", 1e-3), Optimizers(parameters(), "muon", 1e-3)
    with pytest.raises(ValueError, match="another optimizer"):
        muon.load_state_dict(adam.state_dict())
    muon.load_state_dict(muon.state_dict())


def test_stacked_matrices_move_as_one_after_another():
    generator = torch.Generator().manual_seed(2)
    shapes = [(32, 32), (32, 90), (32, 32), (64, 32), (16, 48), (32, 32)]
    ours, theirs = ([torch.nn.Parameter(torch.ones(shape)) for shape in shapes] for _ in range(2))
    stacked = BatchedMuon(ours, 1e-2)
    reference = torch.optim.Muon(theirs, lr=1e-2, weight_decay=0.0, adjust_lr_fn="match_rms_adamw")
    for _ in range(4):
        for a, b in zip(ours, theirs, strict=True):
            a.grad = torch.randn(a.shape, generator=generator)
            b.grad = a.grad.clone()
        stacked.step()
        reference.step()
    for a, b in zip(ours, theirs, strict=True):
        moved = float((b - 1.0).norm())
        assert moved > 0.1 and float((a - b).norm()) < 0.02 * moved, "bfloat16 iterations agree up to rounding"
    buffers = [optimizer.state_dict()["state"] for optimizer in (stacked, reference)]
    torch.testing.assert_close(*buffers)


def test_a_state_goes_from_fused_steps_to_plain_ones_and_back():
    named = parameters()
    for value in named.values():
        value.grad = torch.ones_like(value)
    fused, plain = Optimizers(named, "muon", 1e-3, fused=True), Optimizers(named, "muon", 1e-3)
    fused.step()
    plain.load_state_dict(fused.state_dict())
    assert not plain.members[0].param_groups[0]["fused"]
    plain.step()
    fused.load_state_dict(plain.state_dict())
    assert fused.members[0].param_groups[0]["fused"]
    fused.step()
    assert {int(state["step"]) for state in fused.state_dict()[0]["state"].values()} == {3}
