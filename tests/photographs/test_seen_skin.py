"""The skin's pixels pull the fitted head to where it lies over the photograph."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch

from gazenerf.data.rasterizer import Raster, Rasterizer
from gazenerf.geometry import Camera
from gazenerf.head_model.points import double
from gazenerf.photographs.appearance import Seen
from gazenerf.photographs.landmarks import FaceLandmarks
from gazenerf.photographs.picture_terms import SeenSkin
from gazenerf.photographs.seen_skin import BROWS, LEAST_DEVIATION, seen_skin

SAME = np.array([[1.0, 1.0], [0.0, 0.0]])


@pytest.fixture(scope="module")
def laid_over(model, rendered) -> tuple[Seen, tuple[np.ndarray, np.ndarray], np.ndarray]:
    """A person's picture with the true head over it, texture and light, and the head as it is drawn."""
    item = rendered[0]
    points, _ = item.camera.project(item.mesh.vertices[model.landmark_vertices].astype(float))
    with Rasterizer((item.camera.width, item.camera.height), 2) as rasterizer:
        raster: Raster = rasterizer.render_lit(item.mesh, item.codes.illumination, item.camera)
    seen = Seen(item.image, FaceLandmarks(points), item.camera, item.mesh, raster)
    return seen, (item.codes.texture, item.codes.illumination), raster.image


@pytest.fixture(scope="module")
def skin(model, laid_over) -> SeenSkin:
    found = seen_skin(model, *laid_over, 1.2, SAME)
    assert found is not None
    return found


def turned(camera: Camera, turn: np.ndarray) -> Camera:
    """The camera of a head that is turned by a rotation vector."""
    pose = camera.world_from_camera.copy()
    pose[:3] = cv2.Rodrigues(turn)[0] @ pose[:3]
    return replace(camera, world_from_camera=pose)


def cost(skin: SeenSkin, seen: Seen, camera: Camera) -> float:
    pixels, _ = camera.project(seen.mesh.vertices[skin.skin.vertices[0]].astype(np.float64))
    return float(skin.cost(double(pixels), skin.colours))


def test_the_true_pose_costs_least(skin: SeenSkin, laid_over) -> None:
    seen, _, _ = laid_over
    true = cost(skin, seen, seen.camera)
    for axis in np.eye(3):
        for degrees in (-3.0, -1.0, 1.0, 3.0):
            assert cost(skin, seen, turned(seen.camera, np.deg2rad(degrees) * axis)) > 1.2 * true + 0.5


def test_gradients_are_those_of_finite_differences(skin: SeenSkin, laid_over) -> None:
    seen, _, _ = laid_over
    pixels, _ = seen.camera.project(seen.mesh.vertices[skin.skin.vertices[0]].astype(np.float64))
    at = double(pixels + 0.37).requires_grad_(True)
    (gradient,) = torch.autograd.grad(skin.cost(at, skin.colours), at)
    step = 1e-5 * torch.randn(at.shape, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    with torch.no_grad():
        difference = skin.cost(at + step, skin.colours) - skin.cost(at - step, skin.colours)
    assert float(difference) == pytest.approx(2.0 * float((gradient * step).sum()), rel=1e-3)


def test_a_photograph_at_another_size_costs_the_same(model, laid_over, skin: SeenSkin) -> None:
    seen, looks, drawn = laid_over
    other = seen_skin(model, seen, looks, drawn, 1.2, np.array([[0.5, 0.5], [3.0, -2.0]]))
    assert other is not None
    pixels, _ = seen.camera.project(seen.mesh.vertices[skin.skin.vertices[0]].astype(np.float64))
    whole = (pixels - [3.0, -2.0]) / 0.5
    assert float(other.cost(double(whole), other.colours)) == pytest.approx(
        float(skin.cost(double(pixels), skin.colours))
    )


def test_only_skin_below_the_brows_counts_and_what_misses_much_counts_little(model, laid_over, skin: SeenSkin) -> None:
    seen, looks, drawn = laid_over
    highest = max(seen.mesh.landmarks[str(number)][1] for number in BROWS)
    assert seen.mesh.vertices[skin.skin.vertices[0], 1].max() < highest + 0.04
    assert skin.deviation == LEAST_DEVIATION
    strange = seen_skin(model, seen, looks, 255 - drawn, 1.2, SAME)
    assert strange is not None and strange.deviation > 10.0 * LEAST_DEVIATION


def test_where_hardly_any_skin_is_seen_nothing_is_compared(model, laid_over) -> None:
    seen, looks, drawn = laid_over
    nobody = replace(seen, person=np.zeros(seen.image.shape[:2], bool))
    assert seen_skin(model, nobody, looks, drawn, 1.2, SAME) is None
