"""The benchmark compares what it says: the same picture three ways."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from benchmarks.render import compare_paths
from gazenerf.field.config import PRESETS
from gazenerf.field.model import TwoStreamField
from gazenerf.subjects import Codes, Subject


def test_the_exact_path_is_the_reference_and_faster() -> None:
    torch.manual_seed(0)
    config = replace(PRESETS["tiny"], samples=48, hidden=96)
    field = TwoStreamField(config).eval().requires_grad_(False)
    rng = np.random.default_rng(0)
    subject = Subject("someone", Codes(*(rng.normal(size=n).astype(np.float32) for n in config.code_sizes)))
    found = compare_paths(field, subject, frames=3)
    assert found["reference"]["times_faster"] == pytest.approx(1.0)
    assert found["exact"]["least_psnr_db"] > 70
    assert found["exact"]["times_faster"] > 1.0
    assert set(found["guided"]) == {"seconds", "times_faster", "least_psnr_db"}
