"""Gaze by iris triangulation, on drawn eyeballs whose gaze is known."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from gazenerf.checkpoints import bundled_fields, load_field
from gazenerf.evaluation.iris import (
    OPENINGS,
    fit_iris,
    iris_cameras,
    iris_gaze,
    measure_gaze,
    opening_mask,
    openings_window,
    triangulate,
)
from gazenerf.geometry import Camera, Gaze
from gazenerf.head_model import load_head_model
from gazenerf.head_model.eyes import IRIS_ANGLE, PUPIL_ANGLE
from gazenerf.head_model.interface import HeadMesh
from gazenerf.heads import Head
from gazenerf.subjects import load_subject

RADIUS = 0.12
CENTRES = np.array([[0.32, 0.1, 0.7], [-0.32, 0.1, 0.7]])


def _mesh(opening: float = 1.0) -> HeadMesh:
    """A head that is eye openings only."""
    marks = {}
    turn = 2 * np.pi * np.arange(6) / 6
    for first, centre in ((42, CENTRES[0]), (36, CENTRES[1])):
        ring = np.stack([0.13 * np.cos(turn), opening * 0.07 * np.sin(turn), np.full(6, 0.07)], axis=1)
        marks |= {str(first + i): centre + ring[i] for i in range(6)}
    empty = np.zeros((0, 3))
    return HeadMesh(empty, empty.astype(int), np.zeros(0), empty, empty, marks, CENTRES, RADIUS)


def _draw(camera: Camera, gaze: Gaze, size: int) -> np.ndarray:
    """The two eyeballs, unshaded, drawn three times larger and averaged down."""
    big = camera.resized(3 * size)
    origin, rays = big.rays()
    image = np.full((3 * size, 3 * size, 3), 0.55)
    for centre in CENTRES:
        offset = origin - centre
        b = (offset * rays).sum(-1)
        under = b**2 - (offset**2).sum(-1) + RADIUS**2
        hit = under > 0
        outward = (offset + (-b - np.sqrt(np.maximum(under, 0)))[..., None] * rays) / RADIUS
        away = np.arccos(np.clip(outward @ gaze.vector(), -1, 1))
        colour = np.where(away[..., None] < PUPIL_ANGLE, 0.03, np.where(away[..., None] < IRIS_ANGLE, 0.3, 0.85))
        image = np.where(hit[..., None], colour * np.ones(3), image)
    return cv2.resize(image, (size, size), interpolation=cv2.INTER_AREA)


@pytest.mark.parametrize("degrees", [(0, 0), (12, -22), (-10, 25)])
def test_the_gaze_of_drawn_eyes_is_read_to_a_degree(degrees):
    gaze = Gaze.from_degrees(*degrees)
    found = measure_gaze(lambda camera: _draw(camera, gaze, 256), _mesh())
    assert set(found) == {"left", "right"}
    for reading in found.values():
        assert np.rad2deg(reading.gaze.angle_to(gaze)) < 1.0
        assert reading.residual_px < 0.3 and reading.views >= 3


@pytest.mark.parametrize("size", [256, 512])
def test_the_window_holds_both_openings(size):
    mesh = _mesh()
    for camera in iris_cameras(size):
        window = openings_window(mesh, camera, 4)
        left, top = round(camera.cx - window.cx), round(camera.cy - window.cy)
        assert left % 4 == top % 4 == window.width % 4 == window.height % 4 == 0
        assert 0 < window.width * window.height < 0.2 * size**2
        for eye in OPENINGS:
            whole = opening_mask(mesh, eye, camera)
            cut = whole[top : top + window.height, left : left + window.width]
            assert np.array_equal(opening_mask(mesh, eye, window), cut) and cut.sum() == whole.sum() > 100
    beyond = Camera.neutral(256).cropped(400, 400, 64, 64)
    assert openings_window(mesh, beyond, 4) is beyond


def test_windows_of_a_trained_fields_pictures_read_the_same_gaze():
    subject, gaze = load_subject("ada"), Gaze.from_degrees(8.0, -15.0)
    bound, mesh = (
        Head(load_field(bundled_fields()["small"]), subject).at(gaze),
        load_head_model().mesh(subject.codes, gaze),
    )
    cameras = iris_cameras(256)[1:4]
    windows = [openings_window(mesh, camera, bound.field.config.upsampling) for camera in cameras]
    fast, slow = (iris_gaze([(bound.render(c).image, c) for c in views], mesh) for views in (windows, cameras))
    assert set(fast) == set(slow) == {"left", "right"}
    for eye, reading in fast.items():
        assert reading.views == slow[eye].views
        assert np.rad2deg(reading.gaze.angle_to(slow[eye].gaze)) < 0.02


def test_an_eye_without_an_iris_is_not_read():
    camera = Camera.neutral(256)
    blank = np.full((256, 256, 3), 0.8)
    mask = opening_mask(_mesh(), "left", camera)
    assert mask.sum() > 100
    assert fit_iris(blank, mask, camera, CENTRES[0], RADIUS) is None
    noisy = blank + 0.05 * np.random.default_rng(0).normal(size=blank.shape)
    assert fit_iris(noisy, mask, camera, CENTRES[0], RADIUS) is None


def test_closed_lids_are_not_read():
    gaze = Gaze()
    pictures = [(_draw(camera, gaze, 128), camera) for camera in iris_cameras(128)[:2]]
    assert iris_gaze(pictures, _mesh(opening=0.02)) == {}


def test_triangulation_recovers_a_point_and_refuses_one_view():
    point = np.array([0.3, 0.1, 0.8])
    cameras = iris_cameras(256)[:3]
    pixels = [camera.project(point)[0] for camera in cameras]
    np.testing.assert_allclose(triangulate(pixels, cameras), point, atol=1e-9)
    with pytest.raises(ValueError, match="two or more"):
        triangulate(pixels[:1], cameras[:1])
    with pytest.raises(ValueError, match="parallel"):
        triangulate([pixels[0], pixels[0]], [cameras[0], cameras[0]])
