"""What only a GPU can show; the rest of these tests hold the same paths to their references on the CPU."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch

from gazenerf.field.config import PRESETS as FIELDS
from gazenerf.training import loop
from gazenerf.training.batches import BatchMaker
from gazenerf.training.config import PRESETS
from gazenerf.training.feed import Feed
from gazenerf.training.loop import train
from gazenerf.training.runtime import Runtime
from tests.training.test_device_batches import assert_same

DEVICE = "cuda"
FIELD = replace(FIELDS["tiny"], identity=4, expression=3, texture=5)
CONFIG = replace(PRESETS["tiny"], steps=12, batch=2, ema=0.9, learning_rate=1e-3)

pytestmark = pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")


def curve(folder) -> list[float]:
    rows = [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()]
    return [row["whole"] for row in rows if "whole" in row]


def run(captures, folder, eyeballs, config=CONFIG, compile="off", device=DEVICE, **options):
    runtime = Runtime(device, precision="float32", compile=compile)
    return train(captures, FIELD, config, folder, eyeballs=eyeballs, runtime=runtime, **options)


@pytest.mark.parametrize("held", ["device", "ahead"])
def test_batches_are_those_of_the_host(toy_captures, toy_eyeballs, held):
    maker = BatchMaker(toy_captures, 16, eyeballs=toy_eyeballs)
    found, wanted = Feed(maker, CONFIG, Runtime(DEVICE), held=held), Feed(maker, CONFIG, Runtime("cpu"))
    for step in (0, 1, 5):
        assert_same(found.at(step)[1].to(torch.device("cpu")), wanted.at(step)[1])
    found.close()


def test_captures_lie_on_the_device_by_default(toy_captures, toy_eyeballs):
    feed = Feed(BatchMaker(toy_captures, 16, eyeballs=toy_eyeballs), CONFIG, Runtime(DEVICE))
    assert feed.held == "device" and feed.at(0)[1].image.device.type == DEVICE


def test_a_run_learns_as_on_the_cpu_and_resumes(toy_captures, toy_eyeballs, tmp_path):
    """Sample positions are drawn on each device, so the curves are alike, not equal."""
    config = replace(CONFIG, steps=60)
    run(toy_captures, tmp_path / "cpu", toy_eyeballs, config, device="cpu")
    run(toy_captures, tmp_path / "whole", toy_eyeballs, config, held_out=toy_captures[:2])
    run(toy_captures, tmp_path / "parts", toy_eyeballs, config, stop_after=0.0)
    assert len(curve(tmp_path / "parts")) == 1
    run(toy_captures, tmp_path / "parts", toy_eyeballs, config, resume=True)
    reference, whole, parts = (np.array(curve(tmp_path / name)) for name in ("cpu", "whole", "parts"))
    assert np.allclose(parts, whole, rtol=0.02), "sums on a GPU have no fixed order"
    assert whole[-10:].mean() == pytest.approx(reference[-10:].mean(), rel=0.2)
    assert whole[-10:].mean() < 0.9 * whole[:10].mean()


def test_compiled_steps_are_plain_ones(toy_captures, toy_eyeballs, tmp_path):
    said: list[str] = []
    run(toy_captures, tmp_path / "plain", toy_eyeballs)
    run(toy_captures, tmp_path / "compiled", toy_eyeballs, compile="on", say=said.append)
    assert np.allclose(curve(tmp_path / "compiled"), curve(tmp_path / "plain"), rtol=0.02), said


def test_captures_prefetched_make_the_same_steps(toy_captures, toy_eyeballs, tmp_path, monkeypatch):
    run(toy_captures, tmp_path / "held", toy_eyeballs)
    monkeypatch.setattr(loop, "Feed", partial(Feed, held="ahead"))
    run(toy_captures, tmp_path / "ahead", toy_eyeballs)
    assert np.allclose(curve(tmp_path / "ahead"), curve(tmp_path / "held"), rtol=0.02)
