"""Heads whose densities come from signed distances, at balls of known place."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from gazenerf.field.model import TwoStreamField
from gazenerf.geometry import Camera, Gaze
from gazenerf.heads import Head
from gazenerf.heads.baked import bake
from gazenerf.image_metrics import psnr
from tests.field_doubles import make_subject, tiny_config

RADIUS = 0.9
EYES = np.array([[0.35, 0.1, 0.85, 0.15], [-0.35, 0.1, 0.85, 0.15]])


@pytest.fixture(scope="module")
def head() -> Head:
    torch.manual_seed(0)
    config = tiny_config(geometry="distance", distance_width=16, distance_frequencies=3, surface_spread=0.005)
    field = TwoStreamField(config).eval()
    for name, balls in (("face", np.array([[0.0, 0.0, 0.0, RADIUS]])), ("eyes", EYES)):
        network = field.stream(name).distance
        assert network is not None
        for weights in (network.last.weight, network.move.matrix.weight):
            torch.nn.init.zeros_(weights)
        network.set_balls(balls)
    return Head(field.requires_grad_(False), make_subject(config))


def test_depth_and_normals_are_the_balls(head: Head) -> None:
    camera = Camera.orbit(yaw=0.4, size=48)
    view = head.at(Gaze(0.1, 0.2)).render_geometry(camera, "face", normals=True)
    points = view.points()
    seen = np.isfinite(points).all(-1)
    assert seen.mean() > 0.1 and view.normals is not None
    assert np.abs(np.linalg.norm(points[seen], axis=-1) - RADIUS).mean() < 0.01  # twice the spread
    outward = points[seen] / np.linalg.norm(points[seen], axis=-1, keepdims=True)
    facing = (view.normals[seen] * outward).sum(-1)
    assert np.degrees(np.arccos(np.clip(facing, -1, 1))).max() < 0.5


def test_normals_of_the_head_are_those_of_the_nearest_surface(head: Head) -> None:
    rng = np.random.default_rng(0)
    directions = rng.standard_normal((60, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    on_face, on_eye = RADIUS * directions, EYES[0, :3] + EYES[0, 3] * directions
    for points, expected, part in ((on_face, directions, "face"), (on_eye, directions, "eyes")):
        found = head.at(Gaze()).normals(torch.from_numpy(points.astype(np.float32)), part).numpy()
        np.testing.assert_allclose((found * expected).sum(1), 1.0, atol=1e-4)
    outside = directions[np.linalg.norm(on_face[:, None] - EYES[:, :3], axis=-1).min(1) > 0.2]
    found = head.at(Gaze()).normals(torch.from_numpy((RADIUS * outside).astype(np.float32))).numpy()
    np.testing.assert_allclose((found * outside).sum(1), 1.0, atol=1e-4)


def test_eyes_stand_out_of_the_face(head: Head) -> None:
    view = head.at(Gaze()).render_geometry(Camera.neutral(64))
    points = view.points()[np.isfinite(view.depth)]
    away = np.linalg.norm(points[:, None] - EYES[:, :3], axis=-1).min(1)
    on_eyes = np.abs(away - 0.15) < 0.02
    assert on_eyes.sum() > 10 and points[on_eyes, 2].max() > RADIUS


def test_a_bake_is_the_same_head(head: Head) -> None:
    baked = bake(head, Gaze())
    for gaze in (Gaze(), Gaze(0.1, -0.2)):
        camera = Camera.orbit(yaw=-0.3, size=64)
        assert psnr(baked.at(gaze).render(camera).image, head.at(gaze).render(camera).image) > 36.0
