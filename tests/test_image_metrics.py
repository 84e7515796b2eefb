"""Picture quality inside masks."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gazenerf.image_metrics import bounding_crop, eye_crops, psnr, ssim


def test_psnr_is_by_hand_inside_the_mask():
    target = np.zeros((8, 8, 3), np.float32)
    image = target.copy()
    image[:4] = 0.1
    mask = np.zeros((8, 8), bool)
    mask[:4] = True
    assert psnr(image, target, mask) == pytest.approx(20.0, abs=1e-4)
    assert psnr(image, target) == pytest.approx(20.0 + 10 * math.log10(2), abs=1e-4)
    assert psnr(image, target, ~mask) == math.inf
    assert math.isnan(psnr(image, target, np.zeros((8, 8), bool)))


def test_ssim_sees_damage_where_it_is():
    rng = np.random.default_rng(0)
    target = rng.random((40, 40, 3))
    image = target.copy()
    image[:20] = rng.random((20, 40, 3))
    top, bottom = np.zeros((40, 40), bool), np.zeros((40, 40), bool)
    top[:14], bottom[28:] = True, True
    assert ssim(target, target) == pytest.approx(1.0)
    assert ssim(image, target, bottom) == pytest.approx(1.0, abs=1e-6)
    assert abs(ssim(image, target, top)) < 0.2


def test_crops_stay_inside_the_picture():
    parts = np.ones((20, 20), np.uint8)
    parts[0:2, 17:20] = 2
    assert eye_crops(parts, 4) == [(slice(0, 6), slice(13, 20))]
    assert bounding_crop(parts == 3) is None
