"""The benchmark compares what it says: the same picture by every path."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from benchmarks.measure import exponent, flops, paired, peak_memory
from benchmarks.render import compare_paths, compare_upsamplers
from gazenerf.field.config import PRESETS
from gazenerf.field.model import TwoStreamField
from gazenerf.subjects import Codes, Subject


@pytest.fixture
def scene() -> tuple[TwoStreamField, Subject]:
    torch.manual_seed(0)
    config = replace(PRESETS["tiny"], samples=48, hidden=96)
    field = TwoStreamField(config).eval().requires_grad_(False)
    rng = np.random.default_rng(0)
    return field, Subject("someone", Codes(*(rng.normal(size=n).astype(np.float32) for n in config.code_sizes)))


@pytest.mark.filterwarnings("ignore:.*sampled evenly")
def test_the_exact_path_is_the_reference_and_faster(
    scene: tuple[TwoStreamField, Subject], capsys: pytest.CaptureFixture[str]
) -> None:
    found = compare_paths(*scene, frames=3)
    assert found["reference"]["times_faster"] == pytest.approx(1.0)
    assert found["exact"]["least_psnr_db_from_reference"] > 70
    assert found["exact"]["times_faster"] > 1.0
    assert found["reference"]["gflop"] > 1.5 * found["exact"]["gflop"] > 0
    assert (
        "baked" not in found and "not baked: the density of this field is nearly everywhere" in capsys.readouterr().out
    )


def test_upsamplers_are_compared_with_the_module(scene: tuple[TwoStreamField, Subject]) -> None:
    found = compare_upsamplers(scene[0], rounds=2)
    assert found["reference"]["largest_difference"] == 0.0
    assert 0 < found["folded"]["largest_difference"] < 1e-5


def test_measures() -> None:
    a = torch.rand(40, 50)
    assert flops(lambda: a @ a.T) == 2 * 40 * 40 * 50
    assert exponent([1, 2, 4], [3, 12, 48]) == pytest.approx(2.0)
    seconds = paired({"a": lambda: None, "b": lambda: sum(range(10**5))}, rounds=3)
    assert len(seconds["a"]) == 3 and min(seconds["b"]) > max(seconds["a"])
    grown = peak_memory(lambda: np.ones(20_000_000))
    assert grown is None or grown > 100_000_000
