"""Fused operations give what the references give, forward and backward, and stay on their device."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from torch import nn
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode

from gazenerf.field.config import PRESETS as FIELDS
from gazenerf.field.model import TwoStreamField
from gazenerf.field.neural_renderer import NeuralRenderer
from gazenerf.training.batches import BatchMaker
from gazenerf.training.config import PRESETS
from gazenerf.training.device_batches import DeviceBatchMaker
from gazenerf.training.objective import Objective
from gazenerf.training.operations import FUSED, REFERENCE, Operations, compiled

FIELD = replace(FIELDS["tiny"], identity=4, expression=3, texture=5)
CONFIG = replace(PRESETS["tiny"], perceptual=0.5, perceptual_start=0.0, batch=2)


class Backbone(nn.Module):
    """A frozen network of two maps."""

    def __init__(self) -> None:
        super().__init__()
        torch.manual_seed(4)
        self.layers = nn.ModuleList([nn.Conv2d(3, 6, 3, padding=1), nn.Conv2d(6, 8, 3, stride=2)])
        self.requires_grad_(False)

    def forward(self, images: torch.Tensor) -> list[torch.Tensor]:
        found = [torch.relu(self.layers[0](images))]
        return [*found, torch.relu(self.layers[1](found[0]))]


def objective(operations: Operations, features: nn.Module | None = None, **changes: Any) -> Objective:
    torch.manual_seed(3)
    model = TwoStreamField(replace(FIELD, **changes))
    with torch.no_grad():
        for name, value in model.named_parameters():
            if name.startswith("renderer"):
                value += 0.2 * torch.randn_like(value)
    return Objective(model, CONFIG, 16, features or Backbone(), operations=operations)


@pytest.mark.parametrize("channels", [24, 72])
def test_pictures_and_their_gradients_are_the_renderers(channels: int) -> None:
    torch.manual_seed(0)
    renderer = NeuralRenderer(replace(FIELD, image_size=64, feature_channels=channels))
    with torch.no_grad():
        for value in renderer.parameters():
            value += 0.2 * torch.randn_like(value)
    maps = torch.randn(2, 16, 16, channels)
    weights = torch.randn(2, 3, 64, 64)
    found: list[dict[str, torch.Tensor]] = []
    for operations in (REFERENCE, FUSED):
        renderer.zero_grad()
        given = maps.clone().requires_grad_(True)
        image = operations.pictures(renderer, given)
        assert image.shape == (2, 3, 64, 64) and image.dtype == torch.float32
        (weights * image).sum().backward()
        assert given.grad is not None
        gradients = {name: value.grad for name, value in renderer.named_parameters() if value.grad is not None}
        found.append({"image": image.detach(), "maps": given.grad, **gradients})
    assert found[0].keys() == found[1].keys() and len(found[0]) > 10
    assert found[0]["image"].std() > 0.02
    for name, wanted in found[0].items():
        scale = float(wanted.abs().max())
        assert scale > 0, name
        torch.testing.assert_close(found[1][name], wanted, rtol=0, atol=1e-5 * max(scale, 1.0), msg=name)


@pytest.mark.parametrize("changes", [{"merge": "joint"}, {"merge": "max"}])
@pytest.mark.parametrize("step", [0, 1])
def test_the_objective_and_its_gradients_are_the_references(toy_captures, toy_eyeballs, changes, step) -> None:
    batch = BatchMaker(toy_captures, 16, eyeballs=toy_eyeballs).batch([0, 9], np.random.default_rng(0))
    found = []
    for operations in (REFERENCE, FUSED):
        whole = objective(operations, **changes)
        torch.manual_seed(7)
        loss, parts = whole(batch, step)
        loss.backward()
        gradients = {name: value.grad for name, value in whole.named_parameters() if value.grad is not None}
        found.append(({name: float(part) for name, part in parts.items()}, gradients))
    (wanted, their_gradients), (ours, our_gradients) = found
    assert ("face" in wanted) == (step == 0) and "perceptual" in wanted
    assert ours == pytest.approx(wanted, rel=1e-4, abs=1e-6)
    for name, gradient in their_gradients.items():
        scale = float(gradient.abs().max())
        assert float((our_gradients[name] - gradient).abs().max()) <= 2e-3 * scale + 1e-7, name


class MadeOnTheHost(TorchDispatchMode):
    """Records operations whose result is a tensor on the host."""

    def __init__(self, made: list[str]) -> None:
        super().__init__()
        self.made = made

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        out = func(*args, **(kwargs or {}))
        tensors = out if isinstance(out, (tuple, list)) else [out]
        if any(isinstance(item, torch.Tensor) and item.device.type == "cpu" for item in tensors):
            self.made.append(str(func))
        return out


class StagedOnTheHost(TorchFunctionMode):
    """Records calls that copy Python numbers or arrays to a device, for which a GPU waits."""

    NAMES = ("tensor", "as_tensor", "from_numpy", "new_tensor")

    def __init__(self, made: list[str]) -> None:
        super().__init__()
        self.made = made

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        if getattr(func, "__name__", "") in self.NAMES:
            self.made.append(func.__name__)
        return func(*args, **(kwargs or {}))


@contextmanager
def host_tensors() -> Iterator[list[str]]:
    made: list[str] = []
    with MadeOnTheHost(made), StagedOnTheHost(made):
        yield made


@pytest.fixture
def autocast_on_meta(monkeypatch: pytest.MonkeyPatch) -> None:
    """The meta device knows no mixed precision: there it is a context that does nothing."""
    real, enabled = torch.autocast, torch.is_autocast_enabled
    torch.compile(torch.neg, backend="eager")(torch.zeros(1))  # the compiler learns the real functions' names
    monkeypatch.setattr(torch, "autocast", lambda kind, **how: nullcontext() if kind == "meta" else real(kind, **how))
    monkeypatch.setattr(torch, "is_autocast_enabled", lambda kind: kind != "meta" and enabled(kind))


@pytest.mark.parametrize("changes", [{"merge": "joint"}, {"merge": "max"}])
@pytest.mark.parametrize("eyes_box", [None, (-1.0, -1.0, 0.5, 1.0, 1.0, 1.5)])
def test_a_step_makes_nothing_on_the_host_and_asks_it_for_nothing(
    toy_captures, toy_eyeballs, autocast_on_meta, changes, eyes_box
) -> None:
    """Values of the meta device cannot be read, so a step that waits for one fails here."""
    meta = torch.device("meta")
    maker = DeviceBatchMaker(BatchMaker(toy_captures, 16, eyeballs=toy_eyeballs), meta)
    batch = maker.batch([0, 9], np.random.default_rng(0))
    whole = objective(FUSED, Backbone().to(meta), eyes_box=eyes_box, **changes).to(meta)
    with host_tensors() as made:
        loss, _ = whole(batch, 0)
        loss.backward()
    assert made == []
    gradients = [value.grad for name, value in whole.named_parameters() if "background" not in name]
    assert all(gradient is not None and gradient.device == meta for gradient in gradients)


def test_the_recorder_sees_what_is_made_on_the_host() -> None:
    for make in (
        lambda: torch.ones(2, device="meta").new_tensor([1.0, 2.0]),
        lambda: torch.tensor([1.0, 2.0], device="meta"),
        lambda: torch.arange(3),
    ):
        with host_tensors() as made:
            make()
        assert made


def test_compiled_operations_are_one_program_each_and_give_the_same_numbers() -> None:
    """The graph is captured whole, once; which backend turns it into kernels is the machine's matter."""
    torch.manual_seed(0)
    renderer, network, programs = NeuralRenderer(FIELD), Backbone(), []

    def counting(graph: torch.fx.GraphModule, inputs: Any) -> Any:
        programs.append(graph)
        return graph.forward

    fast = compiled(FUSED, backend=counting, fullgraph=True)
    for pictures in (4, 2, 3):
        maps = torch.randn(pictures, 16, 16, 24, requires_grad=True)
        image, target = torch.rand(pictures, 3, 32, 32), torch.rand(pictures, 3, 32, 32)
        torch.testing.assert_close(fast.pictures(renderer, maps), FUSED.pictures(renderer, maps))
        torch.testing.assert_close(fast.perceptual(network, image, target), FUSED.perceptual(network, image, target))
        masks = [target[:, :1] > 0.5, target[:, :1] > 0.9]
        torch.testing.assert_close(
            fast.reconstruction(image, target, masks, "l1"), FUSED.reconstruction(image, target, masks, "l1")
        )
    assert len(programs) == 3
    crop = torch.randn(2, 6, 16, 24)
    torch.testing.assert_close(fast.pictures(renderer, crop), FUSED.pictures(renderer, crop))
    assert len(programs) == 3, "crops run as they are"
