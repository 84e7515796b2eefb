"""What is drawn of a layer, and where it hides what else is in the scene."""

import dataclasses

import numpy as np
import pytest

from gazenerf.geometry import Camera, Gaze
from gazenerf.heads import Head
from gazenerf.heads.baked import bake
from gazenerf.viz.pictures.panels import draw_panels
from gazenerf.viz.viewer.layer_pictures import EMPTY, SLACK, STEP, draw_layer, hiding_depth
from gazenerf.viz.viewer.scene import LAYERS
from tests.field_doubles import FACE_RADIUS, make_subject, soft_field


@pytest.fixture(scope="module")
def head() -> Head:
    field = soft_field()
    return Head(field, make_subject(field.config))


@pytest.mark.parametrize("layer", LAYERS)
def test_a_layer_is_the_panel_beside_a_picture(head, layer):
    bound, camera = head.at(Gaze()), Camera.orbit(0.3, size=48)
    pixels, geometry = draw_layer(bound, camera, layer)
    together = ("image", layer) if layer in ("depth", "opacity") else (layer,)
    assert np.array_equal(pixels, draw_panels(bound, camera, together)[layer])
    assert pixels.shape == (48, 48, 3) and pixels.std() > 5.0
    assert geometry is not None


@pytest.mark.parametrize("layer", ["depth", "opacity"])
def test_the_depth_of_a_bake_needs_no_rays_of_its_own(head, layer, monkeypatch):
    bound = bake(head, Gaze()).at(Gaze())
    monkeypatch.setattr(type(bound), "render_geometry", None)
    assert draw_layer(bound, Camera.orbit(0.3, size=48), layer)[0].std() > 5.0


def test_things_are_hidden_a_little_behind_the_surface_and_nowhere_beside_it(head):
    camera = Camera.orbit(0.0, size=96)
    _, geometry = draw_layer(head.at(Gaze()), camera, "face")
    assert geometry is not None
    depth = hiding_depth(geometry)
    assert depth.dtype == np.float32 and depth.shape == geometry.depth.shape
    rows, columns = np.indices(depth.shape)
    small = geometry.camera
    (centre,), _ = small.project(np.zeros((1, 3)))
    away = np.hypot(columns + 0.5 - centre[0], rows + 0.5 - centre[1]) * 12.0 / small.fx
    inside, outside = away < 0.5 * FACE_RADIUS, away > 1.2 * FACE_RADIUS
    surface = 12.0 - np.sqrt(np.maximum(FACE_RADIUS**2 - away**2, 0.0))
    behind = depth[inside] - surface[inside]
    assert behind.min() > 0.0 and np.median(behind) < 0.1 + SLACK
    assert np.all(depth[outside] >= EMPTY - STEP)
    steps = depth / STEP
    np.testing.assert_allclose(steps, steps.round(), atol=0.02)


def test_a_tilted_surface_is_measured_along_the_cameras_axis(head):
    _, geometry = draw_layer(head.at(Gaze()), Camera.orbit(0.0, size=96), "face")
    assert geometry is not None
    flat = dataclasses.replace(geometry, depth=(12.0 / geometry.camera.ray_z()).astype(np.float32))
    np.testing.assert_allclose(hiding_depth(flat), 12.0 + SLACK, atol=STEP)
