"""The patch of the face shows the face, whatever the camera of the picture."""

from __future__ import annotations

import numpy as np
import pytest

from gazenerf.geometry import Camera
from gazenerf.training.face_patch import SIDE, face_centre, face_patch, patch_camera


@pytest.mark.parametrize("level", [True, False])
@pytest.mark.parametrize(("yaw", "pitch", "size"), [(0.0, 0.0, 256), (0.7, -0.3, 256), (-1.1, 0.2, 512)])
def test_points_lie_in_the_patch_where_its_camera_sees_them(yaw, pitch, size, level):
    camera = Camera.orbit(yaw, pitch, size=size, distance=11.6)
    patch = patch_camera(camera, level)
    point = np.asarray(face_centre()) + np.array([0.2, -0.1, 0.05])
    x, y = camera.project(point)[0]
    rows, columns = np.mgrid[:size, :size] + 0.5
    picture = np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / 18.0)[..., None].repeat(3, 2).astype(np.float32)
    found = face_patch(picture, camera, level)[..., 0].astype(np.float64)
    assert found.shape == (SIDE, SIDE)
    rows, columns = np.mgrid[:SIDE, :SIDE] + 0.5
    centre = np.array([(found * columns).sum(), (found * rows).sum()]) / found.sum()
    np.testing.assert_allclose(centre, patch.project(point)[0], atol=0.1)


@pytest.mark.parametrize("distance", [9.0, 12.0])
def test_the_face_is_as_large_as_published_patches_have_it(distance):
    patch = patch_camera(Camera.orbit(0.3, size=128, distance=distance))
    centre = np.asarray(face_centre())
    middle, _ = patch.project(centre)
    np.testing.assert_allclose(middle, SIDE / 2, atol=1e-6)
    aside, _ = patch.project(centre + 0.35 * patch.world_from_camera[:3, 0])
    assert aside[0] - middle[0] == pytest.approx(960.0 * 35.0 / 600.0, rel=1e-6), (
        "35 mm of 600 at a focal length of 960"
    )


def test_published_patches_are_held_by_the_horizontal_axis():
    camera = Camera.orbit(0.8, 0.4)
    for level, axis, across in ((True, (0, 1, 0), 0), (False, (1, 0, 0), 1)):
        patch = patch_camera(camera, level)
        ends = patch.project(np.stack([face_centre(), np.asarray(face_centre()) + 1e-4 * np.asarray(axis)]))[0]
        assert abs((ends[1] - ends[0])[across]) < 1e-6, "the axis lies along the patch"
