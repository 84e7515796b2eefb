"""A run goes on where a GPU lacks memory or a compiler, keeps time, and fits its checkpoints."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch

from gazenerf.checkpoints import load_field
from gazenerf.errors import UserError
from gazenerf.field.config import PRESETS as FIELDS
from gazenerf.field.model import TwoStreamField
from gazenerf.training import loop
from gazenerf.training.averaging import average_weights, update_average
from gazenerf.training.config import PRESETS, TrainConfig
from gazenerf.training.feed import Feed
from gazenerf.training.initial import starting_field
from gazenerf.training.loop import train
from gazenerf.training.objective import Objective, schedule
from gazenerf.training.pace import Pace
from gazenerf.training.runtime import Runtime

FIELD = replace(FIELDS["tiny"], identity=4, expression=3, texture=5)
CONFIG = replace(PRESETS["tiny"], steps=6, batch=2, ema=0.9, learning_rate=3e-3)


def rows(folder) -> list[dict]:
    found = [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()]
    return [row for row in found if "whole" in row]


def run(captures, folder, eyeballs, config=CONFIG, runtime=None, **options):
    runtime = runtime or Runtime("cpu", precision="float32")
    return train(captures, FIELD, config, folder, eyeballs=eyeballs, runtime=runtime, **options)


def fused_runtime() -> Runtime:
    """The fused path of a GPU, on the CPU."""
    runtime = Runtime("cpu", precision="float32")
    runtime.fused = True
    return runtime


def fails_once(monkeypatch, error: Exception, at: int) -> None:
    real, left = Objective.forward, [error]

    def forward(self, batch, step, *rest):
        if step == at and left:
            raise left.pop()
        return real(self, batch, step, *rest)

    monkeypatch.setattr(Objective, "forward", forward)


def test_the_fused_path_trains_as_the_reference_does(toy_captures, toy_eyeballs, tmp_path, monkeypatch):
    wanted = run(toy_captures, tmp_path / "reference", toy_eyeballs)
    monkeypatch.setattr(loop, "Feed", partial(Feed, held="device"))
    found = run(toy_captures, tmp_path / "fused", toy_eyeballs, runtime=fused_runtime())
    for ours, theirs in zip(rows(tmp_path / "fused"), rows(tmp_path / "reference"), strict=True):
        assert ours.keys() == theirs.keys()
        assert ours["whole"] == pytest.approx(theirs["whole"], rel=5e-3)
    start = TwoStreamField(FIELD).state_dict()
    for name, value in wanted.state_dict().items():
        moved = float((value - start[name]).norm())
        assert float((found.state_dict()[name] - value).norm()) <= 0.05 * moved + 1e-6, name


def test_a_fused_run_resumes_with_the_same_curve(toy_captures, toy_eyeballs, tmp_path):
    run(toy_captures, tmp_path / "whole", toy_eyeballs, runtime=fused_runtime())
    with pytest.raises(KeyboardInterrupt):
        run(
            toy_captures, tmp_path / "parts", toy_eyeballs, runtime=fused_runtime(), save_every=2,
            on_step=lambda state: (_ for _ in ()).throw(KeyboardInterrupt) if state.step == 5 else None,
        )  # fmt: skip
    run(toy_captures, tmp_path / "parts", toy_eyeballs, runtime=fused_runtime(), resume=True)
    a, b = ([row["whole"] for row in rows(tmp_path / name)] for name in ("whole", "parts"))
    assert len(a) == CONFIG.steps and np.allclose(a, b, atol=1e-6)


def test_the_average_in_one_kernel_is_the_frameworks():
    model = TwoStreamField(FIELD)
    ours, theirs = average_weights(model, 0.9), average_weights(model, 0.9)
    for updates in range(1, 15):
        with torch.no_grad():
            for value in model.parameters():
                value += 0.1
        update_average(ours, model, updates, 0.9)
        theirs.update_parameters(model)
    assert int(ours.n_averaged) == int(theirs.n_averaged)
    torch.testing.assert_close(ours.module.state_dict(), theirs.module.state_dict())


def test_without_memory_captures_leave_the_device_and_the_curve_stays(
    toy_captures, toy_eyeballs, tmp_path, monkeypatch
):
    run(toy_captures, tmp_path / "plain", toy_eyeballs)
    monkeypatch.setattr(loop, "Feed", partial(Feed, held="device"))
    fails_once(monkeypatch, torch.OutOfMemoryError("CUDA out of memory. Tried to allocate"), at=3)
    said: list[str] = []
    run(toy_captures, tmp_path / "moved", toy_eyeballs, say=said.append)
    assert len(said) == 1 and "main memory" in said[0]
    a, b = ([row["whole"] for row in rows(tmp_path / name)] for name in ("plain", "moved"))
    assert len(b) == CONFIG.steps and np.allclose(a, b, atol=1e-5)


def test_without_memory_for_the_step_the_line_says_what_to_lower(toy_captures, toy_eyeballs, tmp_path, monkeypatch):
    fails_once(monkeypatch, torch.OutOfMemoryError("CUDA out of memory. Tried to allocate"), at=1)
    with pytest.raises(UserError, match=r"--set batch=1, then --resume") as caught:
        run(toy_captures, tmp_path, toy_eyeballs)
    assert "\n" not in str(caught.value)


def test_what_cannot_be_compiled_runs_plainly_and_says_so_once(toy_captures, toy_eyeballs, tmp_path, monkeypatch):
    def broken(*args):
        raise RuntimeError("no compiler\nis installed")

    monkeypatch.setattr("gazenerf.training.runtime.compiled", lambda ops: replace(ops, pictures=broken))
    said: list[str] = []
    runtime = Runtime("cpu", precision="float32", compile="on")
    run(toy_captures, tmp_path / "compiled", toy_eyeballs, runtime=runtime, say=said.append)
    assert len(said) == 1 and "torch.compile" in said[0] and "\n" not in said[0]
    run(toy_captures, tmp_path / "plain", toy_eyeballs)
    a, b = ([row["whole"] for row in rows(tmp_path / name)] for name in ("plain", "compiled"))
    assert len(b) == CONFIG.steps and np.allclose(a, b, rtol=1e-2)


def test_other_errors_of_a_step_are_not_hidden(toy_captures, toy_eyeballs, tmp_path, monkeypatch):
    fails_once(monkeypatch, RuntimeError("a fault of ours"), at=0)
    with pytest.raises(RuntimeError, match="a fault of ours"):
        run(toy_captures, tmp_path, toy_eyeballs)


class Clock:
    """Six seconds a step."""

    def __init__(self) -> None:
        self.now = 100.0

    def monotonic(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch) -> Clock:
    clock, real = Clock(), Objective.forward

    def forward(self, *args):
        clock.now += 6.0
        return real(self, *args)

    monkeypatch.setattr(loop, "time", clock)
    monkeypatch.setattr(Objective, "forward", forward)
    return clock


def test_time_shapes_a_run_that_ends_finished_and_resumes_where_it_stopped(
    toy_captures, toy_eyeballs, tmp_path, clock, monkeypatch
):
    seen: list[float | None] = []
    real = loop.schedule

    def watched(config, step, share):
        seen.append(share)
        return real(config, step, share)

    monkeypatch.setattr(loop, "schedule", watched)
    field = run(toy_captures, tmp_path / "whole", toy_eyeballs, minutes=1.0)
    assert seen == pytest.approx([0.1 * step for step in range(10)])
    assert [row["step"] for row in rows(tmp_path / "whole")] == list(range(1, 11))
    assert not field.training and load_field(tmp_path / "whole" / "field.safetensors").about["shaped_to_minutes"] == 1.0
    seen.clear()
    run(toy_captures, tmp_path / "parts", toy_eyeballs, minutes=1.0, stop_after=0.35)
    assert len(seen) == 4
    run(toy_captures, tmp_path / "parts", toy_eyeballs, minutes=1.0, resume=True)
    assert seen == pytest.approx([0.1 * step for step in range(10)])
    a, b = ([row["whole"] for row in rows(tmp_path / name)] for name in ("whole", "parts"))
    assert np.allclose(a, b, atol=1e-6), "with the same clock, the same curve"


def test_a_run_shaped_by_time_is_resumed_so(toy_captures, toy_eyeballs, tmp_path, clock):
    run(toy_captures, tmp_path / "timed", toy_eyeballs, minutes=0.2)
    with pytest.raises(UserError, match="give --minutes again"):
        run(toy_captures, tmp_path / "timed", toy_eyeballs, resume=True)
    run(toy_captures, tmp_path / "steps", toy_eyeballs, replace(CONFIG, steps=1))
    with pytest.raises(UserError, match="resume it without"):
        run(toy_captures, tmp_path / "steps", toy_eyeballs, resume=True, minutes=1.0)


@pytest.mark.parametrize("minutes", [0.0, -1.0, float("nan"), float("inf")])
def test_impossible_minutes_are_refused(toy_captures, toy_eyeballs, tmp_path, minutes):
    with pytest.raises(UserError, match="--minutes must be above 0"):
        run(toy_captures, tmp_path, toy_eyeballs, minutes=minutes)


def test_the_schedule_of_a_share_warms_up_and_ends_low():
    config = TrainConfig(warmup=100, learning_rate=1.0, final_learning_rate=0.1)
    fast = [schedule(config, step, step / 1000) for step in range(1001)]
    assert fast[0] == pytest.approx(0.02, abs=0.011) and max(fast) > 0.98
    assert fast[-1] == pytest.approx(0.1)
    assert fast[100:] == sorted(fast[100:], reverse=True)
    slow = [schedule(config, step, step / 20) for step in range(21)]
    assert slow[1] > 0.9, "a twentieth of the time is warm-up enough, however few steps that was"


def test_a_pace_knows_how_many_steps_to_expect():
    pace = Pace(100, minutes=1.0)
    pace.tick(15.0)
    assert pace.share(3) == pytest.approx(0.25) and pace.steps_expected(30) == 120 and not pace.done(1000)
    assert Pace(100).share(25) == 0.25 and Pace(100).steps_expected(3) == 100 and Pace(100).done(100)


def test_a_checkpoint_that_fits_is_where_a_run_begins(toy_captures, toy_eyeballs, tmp_path):
    first = run(toy_captures, tmp_path / "first", toy_eyeballs)
    again = run(
        toy_captures, tmp_path / "again", toy_eyeballs, replace(CONFIG, steps=1, learning_rate=1e-9, ema=0.0),
        initial=load_field(tmp_path / "first" / "field.safetensors"),
    )  # fmt: skip
    for name, value in first.state_dict().items():
        assert torch.allclose(again.state_dict()[name], value, atol=1e-6), name


@pytest.mark.parametrize("change", [{"hidden": 64}, {"merge": "max"}, {"identity": 5}])
def test_a_checkpoint_that_does_not_fit_is_one_line(change):
    with pytest.raises(UserError, match=f"does not fit the preset: it has {next(iter(change))}") as caught:
        starting_field(FIELD, TwoStreamField(replace(FIELD, **change)))
    assert "\n" not in str(caught.value) and "--preset" in str(caught.value)


def test_a_state_of_another_field_is_one_line(toy_captures, toy_eyeballs, tmp_path):
    run(toy_captures, tmp_path, toy_eyeballs, replace(CONFIG, steps=1))
    wider = replace(FIELD, hidden=48)
    with pytest.raises(UserError, match="cannot resume from") as caught:
        train(toy_captures, wider, CONFIG, tmp_path, eyeballs=toy_eyeballs, resume=True)
    assert "\n" not in str(caught.value)


def test_a_device_that_is_not_there_is_one_line():
    if torch.cuda.is_available():
        pytest.skip("a CUDA device is there")
    with pytest.raises(UserError, match="--device cpu"):
        Runtime("cuda")
