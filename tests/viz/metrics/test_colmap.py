"""COLMAP finds the cameras of an exact scene, and not those of pictures that do not fit together."""

from __future__ import annotations

import subprocess

import numpy as np
import pytest

from gazenerf.geometry import Camera
from gazenerf.viz.metrics import colmap as colmap_check
from gazenerf.viz.metrics.colmap import middle_of_attention, run_colmap, similarity, unavailable
from tests.textured_double import TexturedField

ORBIT = [
    Camera.orbit(np.deg2rad(yaw), np.deg2rad(5.0 + yaw / 4), size=224, fov=0.248 if i % 2 else 0.21)
    for i, yaw in enumerate(range(-28, 29, 8))
]
"""Two lenses in turn."""

needs_colmap = pytest.mark.skipif(unavailable() is not None, reason="needs pycolmap")


@needs_colmap
def test_cameras_of_an_exact_scene_are_found_and_a_camera_fault_is_read():
    images = [TexturedField().render(camera).image for camera in ORBIT]
    found = run_colmap(images, ORBIT)
    assert found.reason == "" and found.registered == found.pictures == len(ORBIT)
    assert found.points > 100 and found.reprojection_px < 1.0
    assert found.position_percent < 1.0 and found.turn_deg < 0.5
    wider = [Camera.orbit(np.deg2rad(1.4 * yaw), np.deg2rad(5.0), size=224) for yaw in range(-28, 29, 8)]
    wrong = run_colmap(images, wider)
    assert wrong.position_percent > 3.0 and wrong.turn_deg > 1.0


@needs_colmap
def test_pictures_without_texture_give_a_reason_and_no_number():
    found = run_colmap([np.full((64, 64, 3), 0.5, np.float32)] * 3, [camera.resized(64) for camera in ORBIT[:3]])
    assert "too few matches" in found.reason or "COLMAP failed" in found.reason
    assert found.registered == 0 and np.isnan(found.reprojection_px)


def test_a_process_that_dies_or_hangs_is_reported_and_does_not_take_this_one_along(monkeypatch):
    monkeypatch.setattr(colmap_check, "unavailable", lambda: None)
    images = [np.zeros((8, 8, 3), np.float32)]

    def dies(command, **settings):
        return subprocess.CompletedProcess(command, -6, "", "F1125 Check failed: x > 0\n")

    monkeypatch.setattr(colmap_check.subprocess, "run", dies)
    assert run_colmap(images, ORBIT[:1]).reason == "COLMAP failed: F1125 Check failed: x > 0"

    def hangs(command, **settings):
        raise subprocess.TimeoutExpired(command, settings["timeout"])

    monkeypatch.setattr(colmap_check.subprocess, "run", hangs)
    assert "within 7 s" in run_colmap(images, ORBIT[:1], timeout_s=7.0).reason


def test_without_pycolmap_the_extra_is_named(monkeypatch):
    monkeypatch.setattr(colmap_check, "find_spec", lambda name: None)
    found = run_colmap([np.zeros((8, 8, 3), np.float32)], ORBIT[:1])
    assert "gazenerf[sfm]" in found.reason and found.registered == 0


def test_a_similarity_is_read_back():
    poses = np.array([camera.world_from_camera for camera in ORBIT])
    turn = Camera.orbit(0.7, 0.4).world_from_camera[:3, :3]
    moved = poses.copy()
    moved[:, :3, :3] = turn @ poses[:, :3, :3]
    moved[:, :3, 3] = 2.5 * poses[:, :3, 3] @ turn.T + [1.0, -2.0, 3.0]
    scale, rotation, shift = similarity(poses, moved)
    assert scale == pytest.approx(2.5) and rotation == pytest.approx(turn) and shift == pytest.approx([1.0, -2.0, 3.0])


def test_the_middle_of_attention_is_where_the_axes_meet():
    cameras = [Camera.orbit(yaw, 0.2, target=(1.0, 2.0, 3.0)) for yaw in (0.0, 0.8, 2.0)]
    assert middle_of_attention(cameras) == pytest.approx([1.0, 2.0, 3.0])
