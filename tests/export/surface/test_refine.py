"""Sparse sampling gives the surfaces of the dense grid."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from gazenerf.export.mesh.cleaning import keep_largest
from gazenerf.export.surface import refine
from gazenerf.export.surface.densities import DensityGrid, sample_density
from gazenerf.export.surface.isosurface import isosurface
from gazenerf.export.surface.refine import refine_density
from gazenerf.geometry import Gaze
from gazenerf.heads.analytic import AnalyticField
from gazenerf.heads.interface import Part
from gazenerf.loading import load

BOX = np.array([[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]])


class SampledField(AnalyticField):
    """Density given by a function of points (N, 3); counts the points it is asked for."""

    def __init__(self, values) -> None:
        super().__init__()
        self.box, self.values, self.asked = BOX, values, []

    def density(self, points: torch.Tensor, part: Part = "head") -> torch.Tensor:
        self.asked.append(points.numpy().copy())
        return torch.as_tensor(np.asarray(self.values(points.double().numpy()), dtype=np.float32))


def blobs(seed: int, size: int = 40, smooth: float = 3.0, share: float = 0.5) -> SampledField:
    """Random smooth density whose surfaces leave the box, 1 on the surface that encloses a share of it."""
    noise = gaussian_filter(np.random.default_rng(seed).normal(size=(size,) * 3), smooth)
    noise = np.exp(3.0 * (noise - np.quantile(noise, 1.0 - share)) / noise.std())
    return SampledField(lambda p: map_coordinates(noise, ((p + 1.0) * 0.5 * (size - 1)).T, order=1))


def surface_points(grid: DensityGrid, level: float) -> np.ndarray:
    """Vertices of the surface, sorted."""
    vertices = np.round(isosurface(grid, level).vertices, 9)
    return vertices[np.lexsort(vertices.T)]


def crossed_cells(values: np.ndarray, low: float, high: float) -> np.ndarray:
    """Cells whose corners are not all on one side of all levels from low to high."""
    corners = [
        values[tuple(slice(o, n - 1 + o) for o, n in zip(offset, values.shape, strict=True))]
        for offset in np.ndindex(2, 2, 2)
    ]
    return (np.max(corners, axis=0) >= low) & (np.min(corners, axis=0) <= high)


def pieces(values: np.ndarray, low: float, high: float) -> np.ndarray:
    """For each cell the number of the surface piece it is in, joined through crossed faces; -1 where none is."""
    cells = crossed_cells(values, low, high)
    number = np.arange(cells.size).reshape(cells.shape)
    near, far = [], []
    for axis in range(3):
        inner = tuple(slice(1, -1) if i == axis else slice(None) for i in range(3))
        flat = [n - 1 for n in values.shape]
        flat[axis] = values.shape[axis]
        corners = []
        for offset in np.ndindex(2, 2):
            shift = np.insert(np.array(offset), axis, 0)
            corners.append(values[tuple(slice(o, o + n) for o, n in zip(shift, flat, strict=True))])
        face = ((np.max(corners, axis=0) >= low) & (np.min(corners, axis=0) <= high))[inner]
        lower = tuple(slice(None, -1) if i == axis else slice(None) for i in range(3))
        upper = tuple(slice(1, None) if i == axis else slice(None) for i in range(3))
        near.append(number[lower][face])
        far.append(number[upper][face])
    pairs = np.concatenate(near), np.concatenate(far)
    graph = coo_matrix((np.ones(len(pairs[0]), bool), pairs), shape=(cells.size,) * 2)
    return np.where(cells, connected_components(graph, directed=False)[1].reshape(cells.shape), -1)


def assert_whole_surfaces(dense: DensityGrid, refined: DensityGrid, low: float, high: float, factor: int) -> None:
    """The refined grid has whole pieces of the dense one's surfaces, and all that coarse points tell of."""
    found = crossed_cells(refined.values, low, high)
    for offset in np.ndindex(2, 2, 2):
        corner = tuple(slice(o, n - 1 + o) for o, n in zip(offset, dense.values.shape, strict=True))
        assert np.allclose(refined.values[corner][found], dense.values[corner][found], rtol=1e-4, atol=1e-4)
    piece = pieces(dense.values, low, high)
    missed = piece[(piece >= 0) & ~found]
    assert not np.isin(missed, piece[found]).any()
    ticks = [np.unique(np.append(np.arange(0, n, factor), n - 1)) for n in dense.values.shape]
    for axis in range(3):
        along = [*ticks]
        along[axis] = np.arange(dense.values.shape[axis])
        lines = np.moveaxis(dense.values[np.ix_(*along)], axis, 0)
        got = np.moveaxis(refined.values[np.ix_(*along)], axis, 0)
        near, far = lines[ticks[axis][:-1]], lines[ticks[axis][1:]]
        mixed = (np.maximum(near, far) >= low) & (np.minimum(near, far) <= high)
        assert mixed.any()
        for i, (start, end) in enumerate(zip(ticks[axis][:-1], ticks[axis][1:], strict=True)):
            exact = lines[start : end + 1][:, mixed[i]]
            assert np.allclose(got[start : end + 1][:, mixed[i]], exact, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("factor", [2, 3, 4, 7, None])
@pytest.mark.parametrize("resolution", [33, 64, 90])
@pytest.mark.parametrize("part", ["face", "eyes", "head"])
def test_the_surface_is_that_of_the_dense_grid(factor, resolution, part):
    bound = AnalyticField(sharpness=0.1)
    box = bound.box if part != "eyes" else np.array([[-0.5, -0.1, 0.6], [0.5, 0.3, 1.0]])
    dense = sample_density(bound, part, box, resolution)
    refined = refine_density(bound, part, box, resolution, (40.0, 100.0), factor=factor)
    for level in (41.0, 70.0, 99.0):
        a, b = surface_points(dense, level), surface_points(refined, level)
        assert a.shape == b.shape and np.abs(a - b).max() < 1e-5
    assert refined.queries < dense.queries


@pytest.mark.parametrize("levels", [(1.0, 1.0), (0.5, 2.0), (0.2, np.inf)])
@pytest.mark.parametrize("seed", range(6))
def test_surfaces_of_random_blobs_come_out_whole(seed, levels):
    bound = blobs(seed, share=(0.1, 0.5, 0.9)[seed % 3])
    factor = 2 + seed
    dense = sample_density(bound, "face", BOX, 61)
    bound.asked.clear()
    refined = refine_density(bound, "face", BOX, 61, levels, factor=factor)
    assert_whole_surfaces(dense, refined, *levels, factor)
    asked = np.concatenate(bound.asked)
    assert len(np.unique(asked, axis=0)) == len(asked) == refined.queries


def test_a_core_behind_a_gap_that_no_coarse_point_is_in_comes_out(monkeypatch):
    """A ball with a thin gap around its core: a tunnel leads the surface there, coarse points know the core alone."""

    def values(points: np.ndarray) -> np.ndarray:
        radius = np.linalg.norm(points, axis=1)
        axis = np.array([0.36, 0.48, 0.8])
        along = points @ axis
        tunnel = 0.06 - np.linalg.norm(points - along[:, None] * axis, axis=1)
        tunnel = np.minimum(tunnel, np.minimum(along, radius - 0.52))
        gap = np.maximum(tunnel, 0.025 - np.abs(radius - 0.525))
        return np.clip(500.0 * np.minimum(0.8 - radius, -gap) + 50.0, 0.0, 100.0)

    bound = SampledField(values)
    dense = sample_density(bound, "face", BOX, 101)
    refined = refine_density(bound, "face", BOX, 101, (50.0, 50.0), factor=10)
    assert_whole_surfaces(dense, refined, 50.0, 50.0, 10)
    assert np.array_equal(surface_points(dense, 50.0), surface_points(refined, 50.0))
    monkeypatch.setattr(refine._Front, "guessed_crossings", lambda front, ticks: np.empty(0, dtype=int))
    without = refine_density(bound, "face", BOX, 101, (50.0, 50.0), factor=10)
    with pytest.raises(AssertionError):
        assert_whole_surfaces(dense, without, 50.0, 50.0, 10)


@pytest.mark.parametrize("thickness", [0.02, 0.05, 0.2])
def test_a_plate_thinner_than_a_cell_comes_out_where_it_is_seen(thickness):
    """A tilted plate on a thick rod: coarse points miss most of the plate, the rod leads to it."""

    def values(points: np.ndarray) -> np.ndarray:
        plate = thickness / 2 - np.abs(points @ np.array([0.36, 0.48, 0.8]) + 0.01)
        plate = np.minimum(plate, 0.8 - np.abs(points).max(axis=1))
        rod = 0.15 - np.linalg.norm(points[:, :2], axis=1)
        return np.clip(100.0 * np.maximum(plate, rod) + 50.0, 0.0, 100.0)

    bound = SampledField(values)
    dense = sample_density(bound, "face", BOX, 150)
    refined = refine_density(bound, "face", BOX, 150, (50.0, 50.0), factor=10)
    assert np.array_equal(surface_points(dense, 50.0), surface_points(refined, 50.0))
    assert refined.queries * 6 < dense.queries


def test_an_empty_volume_costs_only_coarse_points():
    bound = SampledField(lambda p: np.zeros(len(p)))
    refined = refine_density(bound, "face", BOX, 101, (1.0, 1.0), factor=10)
    assert refined.queries == 11**3 and not refined.values.any()


def test_cost_grows_with_the_surface_and_not_with_the_volume():
    bound = AnalyticField(sharpness=0.1)
    queries = [refine_density(bound, "face", bound.box, n, (100.0, 100.0)).queries - 64**3 for n in (128, 256)]
    assert 3.0 < queries[1] / queries[0] < 5.0


@pytest.mark.parametrize(("part", "level"), [("face", 48.0), ("eyes", 20.0)])
def test_the_bundled_head_comes_out_as_from_the_dense_grid(part, level):
    bound = load().at(Gaze.from_degrees(5.0, -10.0))
    box = np.array([[-0.6, -0.5, 0.4], [0.2, 0.3, 1.2]])
    dense = sample_density(bound, part, box, 56)
    refined = refine_density(bound, part, box, 56, (level, level), factor=4)
    assert_whole_surfaces(dense, refined, level, level, 4)
    whole = [keep_largest(isosurface(grid, level), 1) for grid in (dense, refined)]
    a, b = (mesh.vertices[np.lexsort(np.round(mesh.vertices, 9).T)] for mesh in whole)
    assert a.shape == b.shape and np.abs(a - b).max() < 1e-5
    assert refined.queries * 1.5 < dense.queries
