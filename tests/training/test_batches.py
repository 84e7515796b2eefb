"""What a feature map should show of a capture."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gazenerf.training.batches import BatchMaker
from gazenerf.training.ray_targets import eye_crop, ray_targets
from gazenerf.training.split import is_held_out_view, split_captures


def test_blocks_cover_the_head_and_know_its_distance(toy_captures):
    capture = toy_captures[0]
    target = ray_targets(capture, 16)
    blocks = capture.parts.reshape(16, 2, 16, 2).transpose(0, 2, 1, 3).reshape(256, 4)
    assert set(np.flatnonzero((blocks > 0).any(1))) == set(target.rays[target.has_surface].tolist())
    assert target.face_coverage.sum() == pytest.approx((blocks == 1).mean(1).sum())
    camera = capture.camera.resized(16)
    rays_o, rays_d = camera.rays()
    points = rays_o.reshape(-1, 3)[target.rays] + target.distance[:, None] * rays_d.reshape(-1, 3)[target.rays]
    solid = target.face_coverage == 1
    assert np.abs(np.linalg.norm(points[solid], axis=1) - 1.0).max() < 0.12
    assert np.isfinite(target.distance).all()


def test_eye_rays_are_positions_in_the_cast_rays(toy_captures):
    target = ray_targets(toy_captures[0], 16)
    assert target.eyes_coverage[target.eye_rays].sum() == pytest.approx(target.eyes_coverage.sum())
    assert target.eye_rays.max() < target.rays.size


def test_all_rays_casts_the_whole_map(toy_captures):
    target = ray_targets(toy_captures[0], 16, all_rays=True)
    assert target.rays.size == 256 and target.eye_rays.size == 256


@pytest.mark.parametrize("size", [16, 64, 128, 256])
def test_the_eye_crop_holds_the_eyes_whatever_the_feature_map(toy_captures, size):
    parts = np.zeros((64, 64), np.uint8)
    parts[22:32, 18:30], parts[23:33, 34:46] = 3, 2
    parts = parts[::4, ::4] if size == 16 else np.kron(parts, np.ones((size // 64,) * 2, np.uint8))
    capture = replace(toy_captures[0], parts=parts, depth=(parts > 0).astype(np.float32))
    row, column = ray_targets(capture, size).eye_corner
    height, width = eye_crop(size)
    assert (parts[row : row + height, column : column + width] > 0).sum() == (parts > 0).sum()
    assert height * width <= max(0.1 * size**2, 12 * 16), "and little else"


def test_a_picture_that_does_not_fit_the_map_is_refused(toy_captures):
    with pytest.raises(ValueError, match="feature map"):
        ray_targets(toy_captures[0], 15)


def test_batches_pad_to_one_length_and_free_rays_stop_before_the_surface(toy_captures, toy_eyeballs):
    maker = BatchMaker(toy_captures, 16, eyeballs=toy_eyeballs)
    batch = maker.batch([0, 9], np.random.default_rng(0), free_rays=500)
    assert batch.rays.shape == batch.valid.shape == batch.distance.shape
    assert batch.valid.sum(1).tolist() == [maker.targets[0].rays.size, maker.targets[9].rays.size]
    assert batch.eye_centres is not None and batch.eye_centres.shape == (2, 2, 3)
    length = batch.free_d.norm(dim=-1)
    assert float((length - 1).abs().max()) < 1e-5
    ends = batch.rays_o[:, :1] + (batch.free_limit.clamp(max=20.0) - 0.1)[..., None] * batch.free_d
    inside = (ends.norm(dim=-1) < 0.9) & batch.free_limit.isfinite()
    assert not bool(inside.any())


def test_the_split_keeps_the_last_people_and_some_views_out(toy_captures):
    learned, kept = split_captures(toy_captures, 1, 0.25)
    assert {capture.person for capture in learned} == {0}
    assert {capture.view for capture in kept if capture.person == 0} == {3, 7}
    assert not {(c.person, c.view) for c in learned} & {(c.person, c.view) for c in kept}
    assert not is_held_out_view(5, 0.0)
