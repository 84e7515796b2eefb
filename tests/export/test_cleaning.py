"""Steps that make a surface fit for use."""

from __future__ import annotations

import sys

import numpy as np
import pytest
import trimesh
from scipy.ndimage import gaussian_filter

from export.cleaning import Cleaning, decimate, keep_largest, smooth
from export.densities import DensityGrid
from export.isosurface import isosurface
from gazenerf.errors import UserError


@pytest.fixture
def bumpy() -> trimesh.Trimesh:
    ball = trimesh.creation.icosphere(4)
    noise = np.random.default_rng(0).normal(scale=0.01, size=len(ball.vertices))
    return trimesh.Trimesh(ball.vertices * (1.0 + noise[:, None]), ball.faces, process=False)


def roughness(mesh: trimesh.Trimesh) -> float:
    return float(np.linalg.norm(mesh.vertices, axis=1).std())


def test_smoothing_takes_noise_and_keeps_volume(bumpy):
    smoothed = smooth(bumpy, 20)
    assert roughness(smoothed) < 0.5 * roughness(bumpy)
    assert smoothed.volume == pytest.approx(bumpy.volume, rel=0.01)
    assert smoothed.is_watertight and len(smoothed.faces) == len(bumpy.faces)


def assert_reduced(fewer: trimesh.Trimesh, mesh: trimesh.Trimesh, count: int) -> None:
    assert 0.9 * count <= len(fewer.faces) <= count
    assert fewer.is_watertight and fewer.is_winding_consistent
    assert fewer.volume == pytest.approx(mesh.volume, rel=0.01)


def test_decimation_reaches_the_count_and_stays_closed(bumpy):
    fewer = decimate(bumpy, 1000)
    assert_reduced(fewer, bumpy, 1000)
    assert decimate(fewer, 5000) is fewer


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("share", [0.5, 0.2])
def test_decimation_keeps_isosurfaces_closed(seed, share):
    noise = gaussian_filter(np.random.default_rng(seed).normal(size=(48, 48, 48)), 2.0)
    grid = np.linspace(-1, 1, 48)
    radius = np.sqrt(sum(axis**2 for axis in np.meshgrid(grid, grid, grid, indexing="ij")))
    values = np.maximum(0.0, 3.0 + 20.0 * (0.7 - radius) + noise / noise.std()).astype(np.float32)
    surface = isosurface(DensityGrid(values, np.full(3, -1.0), 2.0 / 47, 0), 3.0)
    assert surface.is_watertight
    count = int(share * len(surface.faces))
    assert_reduced(decimate(surface, count), surface, count)


def test_decimation_does_without_open3d(bumpy, monkeypatch):
    monkeypatch.setitem(sys.modules, "open3d", None)
    for count in (2000, 1000, 700):
        assert_reduced(decimate(bumpy, count), bumpy, count)


def test_open3d_stands_in_where_vtk_tears(bumpy, monkeypatch):
    try:
        import open3d  # noqa: F401
    except (ImportError, OSError) as error:
        pytest.skip(f"open3d cannot be loaded: {error}")

    def torn(mesh, max_faces, regularised):
        return trimesh.Trimesh(mesh.vertices, mesh.faces[: int(max_faces) // 2], process=False)

    monkeypatch.setattr("export.cleaning._decimated_by_vtk", torn)
    assert_reduced(decimate(bumpy, 2000), bumpy, 2000)
    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.warns(UserWarning, match="tore it"):
        assert len(decimate(bumpy, 2000).faces) == 1000


def test_an_open_surface_is_reduced_too(bumpy):
    half = trimesh.Trimesh(bumpy.vertices, bumpy.faces[:2560], process=False)
    assert len(decimate(half, 1000).faces) <= 1000


def test_the_largest_pieces_stay():
    large, small = trimesh.creation.icosphere(2), trimesh.creation.icosphere(2, radius=0.2)
    small.apply_translation([3.0, 0.0, 0.0])
    both = trimesh.util.concatenate([small, large])
    assert keep_largest(both, 1).bounds[1, 0] == pytest.approx(1.0)
    assert len(keep_largest(both, 2).faces) == len(both.faces)


def test_steps_are_named_in_order(bumpy):
    cleaning = Cleaning(components=1, smoothing=10, max_faces=500)
    assert [step.split()[0] for step in cleaning.steps()] == ["largest", "Taubin", "quadric"]
    assert len(cleaning.apply(bumpy).faces) <= 500
    assert Cleaning().steps() == () and Cleaning().apply(bumpy) is bumpy


@pytest.mark.parametrize("settings", [{"smoothing": -1}, {"smoothing": 1000}, {"max_faces": 3}])
def test_impossible_settings_are_refused(settings):
    with pytest.raises(UserError):
        Cleaning(**settings)
