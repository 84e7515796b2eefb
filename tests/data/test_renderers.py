"""Both renderers against rays cast by hand, and against each other."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from gazenerf.data.mitsuba_scene import light_picture, whole_grid
from gazenerf.data.path_tracer import PathTracer
from gazenerf.data.protocol import View, plan_view
from gazenerf.data.rasterizer import Raster
from gazenerf.errors import UserError
from gazenerf.geometry import Camera
from gazenerf.head_model.interface import HeadMesh
from gazenerf.head_model.shading import sample_illumination, spherical_harmonics

SIZE = 64


@pytest.fixture(scope="module")
def view(head) -> View:
    planned = plan_view(head, 5, 2, 0, SIZE)
    return View(planned.codes, planned.gaze, Camera.orbit(0.35, 0.1, size=SIZE), 2, 0, 9)


@pytest.fixture(scope="module")
def mesh(head, view) -> HeadMesh:
    return head.mesh(view.codes, view.gaze)


@pytest.fixture(scope="module")
def cameras(mesh, view) -> list[Camera]:
    """The view's, and one close to the eyes whose principal point is off the middle."""
    between = mesh.eye_centres.mean(axis=0)
    close = Camera.look_at(between + np.array([3.0, 1.0, 11.5]), between, size=SIZE, fov=0.1)
    pose = close.world_from_camera
    return [view.camera, Camera(close.fx, close.fy, 27.0, 35.5, SIZE, SIZE, pose)]


def first_hit(mesh: HeadMesh, origin: np.ndarray, direction: np.ndarray) -> tuple[int, float]:
    """Part id and distance of the first face that a ray meets (Moeller and Trumbore 1997), zeros for none."""
    a, b, c = (mesh.vertices[mesh.faces[:, i]].astype(np.float64) for i in range(3))
    p = np.cross(direction, c - a)
    determinant = ((b - a) * p).sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        u = ((origin - a) * p).sum(axis=1) / determinant
        q = np.cross(origin - a, b - a)
        v = q @ direction / determinant
        distance = ((c - a) * q).sum(axis=1) / determinant
        met = (u >= 0) & (v >= 0) & (u + v <= 1) & (distance > 0)
    if not met.any():
        return 0, 0.0
    face = np.flatnonzero(met)[distance[met].argmin()]
    return int(mesh.face_part[face]) + 1, float(distance[face])


def inner_pixels(parts: np.ndarray) -> np.ndarray:
    """(N, 2) rows and columns, some of every part, away from outlines."""
    same = np.ones(parts.shape, bool)
    for axis in (0, 1):
        for shift in (-1, 1):
            same &= np.roll(parts, shift, axis) == parts
    rng = np.random.default_rng(1)
    picked = [rng.permutation(np.argwhere(same & (parts == part)))[:8] for part in range(4)]
    return np.concatenate(picked)


def assert_rays_agree(raster: Raster, mesh: HeadMesh, camera: Camera, tolerance: float) -> None:
    pixels = inner_pixels(raster.parts)
    assert len(pixels) >= 16
    rays_o, rays_d = camera.rays()
    for row, column in pixels:
        part, distance = first_hit(mesh, rays_o[row, column], rays_d[row, column])
        assert raster.parts[row, column] == part
        assert raster.depth[row, column] == pytest.approx(distance, abs=tolerance)


def test_rasterised_parts_and_depth_are_those_of_rays(rasterizer, mesh, view, cameras):
    seen = set()
    for camera in cameras:
        raster = rasterizer.render_lit(mesh, view.codes.illumination, camera)
        assert_rays_agree(raster, mesh, camera, 1e-3)
        seen |= set(raster.parts[tuple(inner_pixels(raster.parts).T)])
    assert seen == {0, 1, 2, 3}


def test_path_traced_parts_and_depth_are_those_of_rays(path_tracer, mesh, view, cameras):
    for camera in cameras:
        raster = path_tracer.render_lit(mesh, view.codes.illumination, camera)
        assert_rays_agree(raster, mesh, camera, 5e-5)
        assert raster.image.dtype == np.uint8 and raster.depth.dtype == np.float32
        np.testing.assert_array_equal(raster.depth > 0, raster.parts > 0)
    assert set(np.unique(raster.parts)) == {1, 2, 3}


def test_cameras_that_mitsuba_lacks_are_refused(path_tracer, mesh, view):
    camera = view.camera
    pose = camera.world_from_camera
    for other in (camera.resized(32), Camera(camera.fx, 1.2 * camera.fy, 32.0, 32.0, SIZE, SIZE, pose)):
        with pytest.raises(ValueError, match=r"32x32|square"):
            path_tracer.render_lit(mesh, view.codes.illumination, other)


def test_renderers_agree_on_a_view(rasterizer, path_tracer, mesh, view):
    drawn = rasterizer.render_lit(mesh, view.codes.illumination, view.camera)
    traced = path_tracer.render_lit(mesh, view.codes.illumination, view.camera)
    assert (drawn.parts == traced.parts).mean() > 0.99
    both = (drawn.parts > 0) & (traced.parts > 0)
    assert 100.0 * np.median(np.abs(drawn.depth - traced.depth)[both]) < 0.2, "millimetres"
    face = both & (traced.parts == 1)
    pictures = [raster.image[face].astype(float) for raster in (drawn, traced)]
    assert np.corrcoef(pictures[0].ravel(), pictures[1].ravel())[0, 1] > 0.9
    assert pictures[1].mean() == pytest.approx(pictures[0].mean(), rel=0.05)


def test_noise_follows_the_seed(path_tracer, mesh, view):
    first, again, other = (
        path_tracer.render_lit(mesh, view.codes.illumination, view.camera, seed).image for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()
    assert np.abs(first.astype(int) - other)[1:-1].mean() < 5


def test_the_cornea_has_a_highlight(path_tracer, head, view):
    mesh = head.mesh(view.codes, view.gaze)
    eye, toward = mesh.eye_centres[0], mesh.landmarks["iris_left"] - mesh.eye_centres[0]
    camera = Camera.look_at(eye + 12.0 * toward / np.linalg.norm(toward), eye, size=SIZE, fov=0.025)
    light = view.codes.illumination.copy()
    raster = path_tracer.render_lit(mesh, light, camera)
    pixels, _ = camera.project(mesh.landmarks["iris_left"])
    rows, columns = np.mgrid[:SIZE, :SIZE] + 0.5
    cornea = (raster.parts == 2) & (np.hypot(columns - pixels[0], rows - pixels[1]) < 0.5 * 0.059 * camera.fx / 11.88)
    brightness = raster.image[cornea].mean(axis=1)
    assert brightness.max() > np.median(brightness) + 60


def test_the_light_keeps_its_harmonics():
    code = sample_illumination(np.random.default_rng(3))
    rows = 64
    picture = light_picture(code, rows).astype(np.float64)
    v, u = np.meshgrid((np.arange(rows) + 0.5) / rows, (np.arange(2 * rows) + 0.5) / (2 * rows), indexing="ij")
    theta, phi = np.pi * v, 2 * np.pi * u
    towards = np.stack([np.sin(theta) * np.sin(phi), np.cos(theta), -np.sin(theta) * np.cos(phi)], axis=-1)
    solid_angle = np.sin(theta) * (np.pi / rows) ** 2
    found = np.einsum("hw,hwk,hwc->kc", solid_angle, spherical_harmonics(towards), picture)
    np.testing.assert_allclose(found.ravel(), code, atol=0.02 * np.abs(code).max())
    assert picture.min() >= 0 and picture.max() > 5 * np.median(picture), "with a catchlight"


@pytest.mark.parametrize(("samples", "grid"), [(1, 1), (2, 2), (16, 16), (32, 35), (64, 64)])
def test_paths_fill_a_grid(samples, grid):
    assert whole_grid(samples) == grid


@pytest.mark.parametrize("samples", [0, -4, 10**6])
def test_impossible_sample_counts_are_refused(samples):
    with pytest.raises(UserError, match="--samples goes from 1 to"):
        PathTracer((SIZE, SIZE), samples)


def test_without_mitsuba_the_fix_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "mitsuba", None)
    with pytest.raises(UserError, match="pip install mitsuba"):
        PathTracer((SIZE, SIZE))
