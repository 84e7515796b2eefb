"""The toy captures of the training tests, and a tiny STED."""

from __future__ import annotations

import pytest
import torch

from gazenerf.baselines.sted import Sted, StedConfig
from tests.training.conftest import toy_captures, toy_folder

__all__ = ["toy_captures", "toy_folder"]

TINY = StedConfig(image_size=32, growth=4, layers=2, appearance=16, one_d=1, two_d=3, width=4)


@pytest.fixture
def tiny_sted() -> Sted:
    """Random weights, also where angles begin at zero."""
    torch.manual_seed(0)
    model = Sted(TINY)
    with torch.no_grad():
        for value in model.encoder.angles.parameters():
            value += 0.05 * torch.randn_like(value)
    return model
