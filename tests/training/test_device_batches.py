"""Batches gathered on a device are those of the reference; prefetched ones too."""

from __future__ import annotations

import dataclasses
from dataclasses import replace

import numpy as np
import pytest
import torch

from gazenerf.training.batches import Batch, BatchMaker
from gazenerf.training.device_batches import DeviceBatchMaker, device_bytes

CPU = torch.device("cpu")


def assert_same(found: Batch, wanted: Batch) -> None:
    for field in dataclasses.fields(Batch):
        a, b = getattr(found, field.name), getattr(wanted, field.name)
        if isinstance(b, torch.Tensor):
            assert a.dtype == b.dtype and a.shape == b.shape, field.name
            if field.name in ("image", "rays_o", "rays_d", "free_d"):  # a GPU divides by multiplying
                torch.testing.assert_close(a, b, rtol=0, atol=2e-7)
            else:
                assert torch.equal(a, b), field.name
        else:
            assert a == b, field.name


@pytest.mark.parametrize("all_rays", [False, True])
@pytest.mark.parametrize("known_eyes", [False, True])
def test_the_same_batch_for_the_same_seed(toy_captures, toy_eyeballs, all_rays, known_eyes):
    maker = BatchMaker(toy_captures, 16, all_rays=all_rays, eyeballs=toy_eyeballs if known_eyes else None)
    held = DeviceBatchMaker(maker, CPU)
    ours, theirs = np.random.default_rng(5), np.random.default_rng(5)
    for indices in ([0, 9], [3], [15, 4, 4]):
        assert_same(held.batch(indices, ours), maker.batch(indices, theirs))
    assert ours.integers(2**31) == theirs.integers(2**31), "both drew as many numbers"


def test_a_capture_without_eyes_pads_as_the_reference_does(toy_captures):
    turned = replace(toy_captures[0], parts=np.minimum(toy_captures[0].parts, 1))
    maker = BatchMaker([turned, toy_captures[1]], 16)
    for indices in ([0], [0, 1]):
        found = DeviceBatchMaker(maker, CPU).batch(indices, np.random.default_rng(1), free_rays=7)
        assert_same(found, maker.batch(indices, np.random.default_rng(1), free_rays=7))


def test_pictures_are_kept_as_bytes(toy_captures):
    maker = BatchMaker(toy_captures, 16)
    held = DeviceBatchMaker(maker, CPU)
    large = [value for value in vars(held).values() if isinstance(value, torch.Tensor) and value.dim() > 2]
    assert {value.dtype for value in large if value[0].numel() >= 32 * 32} == {torch.uint8}
    tables = [*held._rays.values(), held._eye_rays, held._image, held._parts]
    assert device_bytes(maker) == sum(value.nbytes for value in tables)


def test_nothing_stays_on_the_host(toy_captures, toy_eyeballs):
    maker = BatchMaker(toy_captures, 16, eyeballs=toy_eyeballs)
    batch = DeviceBatchMaker(maker, torch.device("meta")).batch([0, 9], np.random.default_rng(0))
    kinds = {value.device.type for value in vars(batch).values() if isinstance(value, torch.Tensor)}
    assert kinds == {"meta"}
