"""The batches of a run's steps are the same wherever its captures are kept."""

from __future__ import annotations

import threading
from dataclasses import replace

import pytest
import torch

from gazenerf.devices import is_out_of_memory
from gazenerf.training.batches import BatchMaker
from gazenerf.training.config import PRESETS
from gazenerf.training.feed import Feed
from gazenerf.training.runtime import Runtime
from tests.training.test_device_batches import assert_same

CONFIG = replace(PRESETS["tiny"], batch=3)


def feed(captures, eyeballs, held, say=lambda text: None):
    return Feed(BatchMaker(captures, 16, eyeballs=eyeballs), CONFIG, Runtime("cpu"), say, held)


@pytest.mark.parametrize("held", ["device", "ahead"])
def test_every_step_has_its_batch_in_any_order(toy_captures, toy_eyeballs, held):
    reference, other = feed(toy_captures, toy_eyeballs, "host"), feed(toy_captures, toy_eyeballs, held)
    assert other.held == held
    for step in (0, 1, 2, 7, 8, 3):
        (epoch, wanted), (found_epoch, found) = reference.at(step), other.at(step)
        assert epoch == found_epoch
        assert_same(found, wanted)
    other.close()


def test_batches_are_made_before_they_are_asked_for(toy_captures, toy_eyeballs, monkeypatch):
    made: list[tuple[int, str]] = []
    real = Feed._make

    def watched(self, step):
        made.append((step, threading.current_thread().name))
        return real(self, step)

    monkeypatch.setattr(Feed, "_make", watched)
    ahead = feed(toy_captures, toy_eyeballs, "ahead")
    ahead.at(0)
    ahead.close()
    assert made[0][0] == 0 and {name.split("_")[0] for _, name in made} == {"batches"}
    ahead = feed(toy_captures, toy_eyeballs, "ahead")
    made.clear()
    ahead.at(0)
    ahead._waiting[2].result()
    assert [step for step, _ in made] == [0, 1, 2]
    ahead.close()


def test_moving_to_main_memory_is_said_once_and_changes_no_batch(toy_captures, toy_eyeballs):
    said: list[str] = []
    other = feed(toy_captures, toy_eyeballs, "device", said.append)
    other.at(0)
    other.keep_in_main_memory("of a test")
    assert other.held == "ahead"
    assert_same(other.at(1)[1], feed(toy_captures, toy_eyeballs, "host").at(1)[1])
    other.close()
    assert len(said) == 1 and "main memory" in said[0] and "\n" not in said[0]


def test_captures_that_do_not_fit_on_the_device_stay_in_main_memory(toy_captures, toy_eyeballs, monkeypatch):
    def full(*args):
        raise torch.OutOfMemoryError("CUDA out of memory")

    monkeypatch.setattr("gazenerf.training.feed.DeviceBatchMaker", full)
    said: list[str] = []
    other = feed(toy_captures, toy_eyeballs, "device", said.append)
    assert other.held == "ahead" and len(said) == 1
    other.close()


@pytest.mark.parametrize(
    ("error", "expected"),
    [
        (torch.OutOfMemoryError("x"), True),
        (RuntimeError("cuDNN error: CUDNN_STATUS_ALLOC_FAILED"), True),
        (RuntimeError("CUDA error: out of memory"), True),
        (RuntimeError("shapes differ"), False),
        (ValueError("out of memory"), False),
    ],
)
def test_what_counts_as_out_of_memory(error, expected):
    assert is_out_of_memory(error) == expected
