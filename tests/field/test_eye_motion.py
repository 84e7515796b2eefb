from __future__ import annotations

import numpy as np
import pytest
import torch

from gazenerf.checkpoints import load_field, save_field
from gazenerf.errors import UserError
from gazenerf.field.eye_motion import EyeCentres, gaze_rotation, keep_features, rotate_features
from gazenerf.field.model import TwoStreamField
from gazenerf.geometry import Camera, Gaze
from gazenerf.geometry.gaze import rotation_x, rotation_y
from gazenerf.head_model import load_head_model
from gazenerf.heads import Head
from gazenerf.training.split import linear_eye_centres
from tests.field_doubles import make_field, make_subject, tiny_config

LABEL = torch.tensor([[0.3, -0.5], [-0.2, 0.1]])


def test_rotation_is_yaw_after_pitch() -> None:
    for label, rotation in zip(LABEL, gaze_rotation(LABEL), strict=True):
        expected = rotation_y(float(label[1])) @ rotation_x(float(label[0]))
        np.testing.assert_allclose(rotation.numpy(), expected, atol=1e-6)


def test_groups_of_three_are_row_vectors() -> None:
    features = torch.randn(2, 5, 258, generator=torch.Generator().manual_seed(0))
    turned = rotate_features(features, LABEL[:, None])
    rotation = gaze_rotation(LABEL)
    for group in (0, 1, 85):
        rows = features[..., 3 * group : 3 * group + 3]
        assert torch.allclose(turned[..., 3 * group : 3 * group + 3], rows @ rotation, atol=1e-5)


def test_rotation_keeps_lengths_and_nothing_else_does() -> None:
    features = torch.randn(2, 30)
    turned = rotate_features(features, LABEL)
    lengths = features.unflatten(-1, (-1, 3)).norm(dim=-1)
    assert torch.allclose(turned.unflatten(-1, (-1, 3)).norm(dim=-1), lengths, atol=1e-5)
    assert not torch.allclose(turned, features, atol=1e-2)
    assert torch.allclose(rotate_features(features, torch.zeros(2, 2)), features, atol=1e-6)
    assert keep_features(features, LABEL) is features


CENTRES = np.array([[0.3, 0.2, 0.8], [-0.3, 0.2, 0.8]], dtype=np.float32)


def rigid_field(**changes: object) -> TwoStreamField:
    """Random weights; eyeballs that turn about `CENTRES` whoever it is, but for the first identity component."""
    config = tiny_config(eye_motion="rigid", **changes)
    field = make_field(config)
    assert field.eye_centres is not None
    basis = np.zeros((config.identity, 2, 3), np.float32)
    basis[0] = 0.01
    field.eye_centres.set(CENTRES, basis)
    return field


def test_points_of_the_turned_eye_are_found_on_the_eye_that_looks_straight_ahead() -> None:
    gazes = [Gaze.from_degrees(20.0, -30.0), Gaze.from_degrees(-10.0, 5.0)]
    still = CENTRES[:, None] + 0.1 * np.random.default_rng(0).normal(size=(2, 6, 3)).astype(np.float32)
    turned = np.stack([(still - CENTRES[:, None]) @ gaze.rotation().T + CENTRES[:, None] for gaze in gazes])
    centres = EyeCentres(4)
    centres.set(CENTRES, np.zeros((4, 2, 3)))
    pose = centres.pose(torch.zeros(2, 4), torch.from_numpy(np.stack([gaze.label for gaze in gazes])))
    found = pose.straight_ahead(torch.from_numpy(turned.astype(np.float32)))
    np.testing.assert_allclose(found.numpy(), np.stack([still, still]), atol=1e-6)


def test_the_head_models_centres_are_linear_in_the_identity_code() -> None:
    model = load_head_model()
    identity = np.random.default_rng(1).normal(size=model.code_sizes[0]).astype(np.float32)
    centres = EyeCentres(len(identity))
    centres.set(*linear_eye_centres(len(identity)))
    found = centres.of(torch.from_numpy(identity)[None])[0].numpy()
    np.testing.assert_allclose(found, model.eye_centres(identity), atol=1e-5)
    with pytest.raises(UserError, match="head model"):
        linear_eye_centres(3)


def test_one_rigid_eye_serves_every_gaze() -> None:
    field = rigid_field()
    head = Head(field, make_subject(field.config))
    gaze = Gaze.from_degrees(12.0, 25.0)
    straight, turned = head.at(Gaze()), head.at(gaze)
    pose = turned.conditions["eyes"].pose
    assert pose is not None
    centre = pose.centres[0, 0]
    points = centre + 0.1 * torch.randn(50, 3, generator=torch.Generator().manual_seed(2))
    moved = centre + (points - centre) @ torch.from_numpy(gaze.rotation().T.astype(np.float32))
    torch.testing.assert_close(turned.query("eyes", moved), straight.query("eyes", points), rtol=1e-3, atol=1e-3)
    assert not torch.allclose(turned.query("eyes", points), straight.query("eyes", points), rtol=1e-2, atol=1e-2)
    assert not torch.allclose(turned.query("face", points), straight.query("face", points), rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("merge", ["max", "joint"])
def test_rigid_eyes_are_drawn_alike_by_the_slow_and_the_fast_path(merge: str) -> None:
    field = rigid_field(merge=merge, sampler="slabs")
    bound = Head(field, make_subject(field.config)).at(Gaze.from_degrees(10.0, -20.0))
    camera = Camera.neutral(field.config.image_size)
    slow = bound.render_slow(camera)["image"][0].permute(1, 2, 0).numpy()
    np.testing.assert_allclose(bound.render(camera).image, slow.clip(0.0, 1.0), atol=2e-3)


def test_the_centres_travel_with_the_weights(tmp_path) -> None:
    field = rigid_field()
    before = field.version
    save_field(field, tmp_path / "rigid.safetensors")
    loaded = load_field(tmp_path / "rigid.safetensors")
    assert loaded.eye_centres is not None
    np.testing.assert_allclose(loaded.eye_centres.mean.numpy(), CENTRES)
    assert field.eye_centres is not None
    field.eye_centres.set(CENTRES + 0.1, field.eye_centres.basis.numpy())
    assert field.version != before


def test_one_stream_has_no_rigid_eyes() -> None:
    with pytest.raises(ValueError, match="rigid"):
        tiny_config(streams="one", eye_motion="rigid")
