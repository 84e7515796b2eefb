"""Eyes are taken apart into white, iris and highlight, and the skin about them moves as the head model's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gazenerf.geometry import Camera, Gaze
from gazenerf.head_model.eyes import IRIS_ANGLE
from gazenerf.head_model.interface import EYE_LEFT, EYE_RIGHT
from gazenerf.photographs.eye_layers import take_apart
from gazenerf.photographs.eyeball import Eyeball
from gazenerf.photographs.lid_motion import harmonic_fill, lid_motion, shown_part
from gazenerf.subjects import Codes

EYE = Eyeball(np.zeros(3), 0.12)
CAMERA = Camera.look_at(np.array([0.0, 0.0, 10.0]), size=160, fov=np.deg2rad(1.6))
UNIT = 0.63 / 10.0 * CAMERA.fx


def painted(gaze: Gaze, glint: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """An eye in linear light, brighter to the right, brown, with a small lamp's reflection; and its opening."""
    u, v = np.moveaxis(CAMERA.pixel_centres(), -1, 0)
    white = (0.5 + 0.2 * (u - 80.0) / 80.0)[..., None] * np.ones(3)
    angle = np.arccos(np.clip(EYE.directions(CAMERA) @ gaze.vector(), -1.0, 1.0))
    soft = np.nan_to_num(1.0 / (1.0 + np.exp((angle - IRIS_ANGLE) / 0.01)))[..., None]
    image = white * (1.0 + soft * (np.array([0.3, 0.2, 0.1]) - 1.0))
    if glint is not None:
        image = image + 0.6 * np.exp(-((u - glint[0]) ** 2 + (v - glint[1]) ** 2) / 8.0)[..., None]
    opening = np.clip(64.0 - np.hypot(u - 80.0, 1.9 * (v - 80.0)), 0.0, 1.0)
    return image, opening


def test_an_eye_without_a_highlight_turns_as_it_was_painted():
    source, target = Gaze(), Gaze.from_degrees(4.0, 14.0)
    image, opening = painted(source)
    layers = take_apart(image, opening, CAMERA, EYE, source, UNIT, 1)
    assert layers.iris_angle == pytest.approx(IRIS_ANGLE, rel=0.05) and layers.highlight.max() < 0.02
    drawn, share, _ = layers.drawn(target, np.zeros((160, 160, 2), np.float32))
    inside = share > 0.99
    assert np.abs(drawn - painted(target)[0])[inside].mean() < 0.006
    assert np.abs(image - painted(target)[0])[inside].mean() > 0.04


def test_its_own_gaze_gives_back_the_picture():
    image, opening = painted(Gaze(), np.array([74.0, 72.0]))
    layers = take_apart(image, opening, CAMERA, EYE, Gaze(), UNIT, 1)
    drawn, share, unseen = layers.drawn(Gaze(), np.zeros((160, 160, 2), np.float32))
    np.testing.assert_allclose(drawn[share > 0], image[share > 0], atol=1e-5)
    assert unseen.max() == 0.0


def test_a_highlight_moves_with_the_cornea_and_not_with_the_iris():
    source, target, lamp = Gaze(), Gaze.from_degrees(0.0, 12.0), np.array([76.0, 74.0])
    image, opening = painted(source, lamp)
    layers = take_apart(image, opening, CAMERA, EYE, source, UNIT, 1)
    drawn, _, _ = layers.drawn(target, np.zeros((160, 160, 2), np.float32))
    excess = (drawn - painted(target)[0]).sum(axis=-1) * (opening > 0.5)
    row, column = np.unravel_index(excess.argmax(), excess.shape)
    expected = lamp + EYE.glint_motion(source, target, CAMERA)
    np.testing.assert_allclose([column + 0.5, row + 0.5], expected, atol=1.5)
    assert excess.max() > 1.2, "as bright as it was"
    iris = EYE.project(np.stack([g.vector() for g in (source, target)]), CAMERA)
    share = np.linalg.norm(expected - lamp) / np.linalg.norm(iris[1] - iris[0])
    assert share == pytest.approx(0.47, abs=0.02)
    stays = np.round(lamp + iris[1] - iris[0]).astype(int)
    assert excess[stays[1], stays[0]] < 0.15, "nothing is left where the iris would have carried it"


def test_harmonic_continuation_reproduces_planes_and_stays_in_its_domain():
    x, y = np.meshgrid(np.arange(30.0), np.arange(20.0))
    plane = np.stack([2.0 * x - y, 0.5 * y], axis=-1)
    known = np.ones((20, 30), bool)
    known[5:15, 8:20] = False
    np.testing.assert_allclose(
        harmonic_fill(np.where(known[..., None], plane, 7.0), known, known | True), plane, atol=1e-9
    )
    domain = np.ones((20, 30), bool)
    domain[:, 15] = False
    left = np.zeros((20, 30), bool)
    left[:, 0] = True
    filled = harmonic_fill(np.full((20, 30, 1), 3.0), left, domain)[..., 0]
    np.testing.assert_allclose(filled[:, :15], 3.0)
    assert (filled[:, 15:] == 0.0).all()


def test_skin_moves_as_the_head_models_vertices_do(model):
    codes = Codes(*(np.zeros(size, np.float32) for size in model.code_sizes))
    codes = replace(codes, illumination=np.full(27, 0.3, np.float32))
    before, after = (model.mesh(codes, Gaze.from_degrees(pitch, 0.0)) for pitch in (0.0, -10.0))
    camera = Camera.neutral(1024)
    centre = camera.project(before.eye_centres[0])[0]
    window = camera.cropped(int(centre[0]) - 60, int(centre[1]) - 60, 120, 120)
    assert np.abs(lid_motion(before, before, window)).max() < 1e-3
    motion = lid_motion(before, after, window)
    for mark in (43, 44):  # the upper lid of the subject's left eye
        old, new = (window.project(mesh.landmarks[str(mark)].astype(float))[0] for mesh in (before, after))
        column, row = np.floor(new).astype(int)
        np.testing.assert_allclose(motion[row, column], old - new, atol=1.0)
        assert old[1] - new[1] < -2.0
    assert shown_part(before, window, EYE_LEFT).sum() > 200 and not shown_part(before, window, EYE_RIGHT).any()


def test_the_gaze_is_told_by_where_the_iris_is_seen():
    gaze = Gaze.from_degrees(9.0, -17.0)
    pixel = CAMERA.project(0.9 * EYE.radius * gaze.vector())[0]
    told = EYE.towards(pixel, CAMERA, 0.9)
    assert told is not None and told.angle_to(gaze) < 1e-9
    assert EYE.towards(np.array([np.nan, 3.0]), CAMERA, 0.9) is None
    assert EYE.towards(np.array([2.0, 80.0]), CAMERA, 0.9) is None, "beside the eyeball"
