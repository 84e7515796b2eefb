"""Steps that make a surface fit for use."""

from __future__ import annotations

import sys

import numpy as np
import pytest
import trimesh
from scipy.ndimage import gaussian_filter

from gazenerf.errors import UserError
from gazenerf.export.mesh.cleaning import Cleaning, decimate, keep_largest, keep_seen, smooth
from gazenerf.export.mesh.repair import close_holes, repair, self_intersections
from gazenerf.export.mesh.triangles import pieces, signed_volumes
from gazenerf.export.surface.densities import DensityGrid
from gazenerf.export.surface.isosurface import isosurface


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

    monkeypatch.setattr("gazenerf.export.mesh.cleaning._decimated_by_vtk", torn)
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
    cleaning = Cleaning(components=1, smoothing=10, max_faces=500, holes=0.1, seen=True, repair=True)
    names = ["repaired", "pieces", "largest", "holes", "Taubin", "quadric"]
    assert [step.split()[0] for step in cleaning.steps()] == names
    assert len(cleaning.apply(bumpy).faces) <= 500
    assert Cleaning().steps() == () and Cleaning().apply(bumpy) is bumpy


@pytest.mark.parametrize(
    "settings", [{"smoothing": -1}, {"smoothing": 1000}, {"max_faces": 3}, {"holes": -1.0}, {"holes": float("nan")}]
)
def test_impossible_settings_are_refused(settings):
    with pytest.raises(UserError):
        Cleaning(**settings)


def ball(radius: float, x: float = 0.0, inverted: bool = False) -> trimesh.Trimesh:
    mesh = trimesh.creation.icosphere(3, radius=radius)
    mesh.apply_translation([x, 0.0, 0.0])
    if inverted:
        mesh.invert()
    return mesh


def test_pieces_and_volumes_are_those_of_trimesh(bumpy):
    both = trimesh.util.concatenate([bumpy, ball(0.3, 5.0)])
    assert np.array_equal(np.bincount(pieces(both)), [len(bumpy.faces), len(ball(0.3).faces)])
    assert signed_volumes(both).sum() == pytest.approx(both.volume)


def test_what_no_camera_can_see_is_dropped():
    shell, cave, speck, hidden = ball(1.0), ball(0.8, inverted=True), ball(0.01, 1.5), ball(0.1, 0.3)
    kept = keep_seen(trimesh.util.concatenate([shell, cave, speck, hidden]))
    assert len(kept.faces) == len(shell.faces) + len(speck.faces)
    assert kept.bounds[1, 0] == pytest.approx(1.51) and kept.is_watertight
    assert keep_seen(kept) is kept


def test_a_core_seen_through_an_opening_stays():
    shell, core = ball(1.0), ball(0.5)
    middle = shell.triangles_center
    open_shell = trimesh.Trimesh(shell.vertices, shell.faces[middle[:, 2] < 0.7], process=False)
    assert len(keep_seen(trimesh.util.concatenate([open_shell, core])).faces) > len(open_shell.faces)


def test_small_holes_are_closed_and_large_ones_stay():
    mesh = ball(1.0)
    middle = mesh.triangles_center
    small, large = middle[:, 2] > 0.98, middle[:, 2] < -0.6
    torn = trimesh.Trimesh(mesh.vertices, mesh.faces[~small & ~large], process=False)
    closed = close_holes(torn, 0.4)
    assert not closed.is_watertight and closed.bounds[1, 2] > 0.9
    edges = np.unique(np.sort(closed.edges, axis=1), axis=0, return_counts=True)
    assert np.asarray(closed.vertices)[edges[0][edges[1] == 1]][..., 2].max() < -0.5
    whole = close_holes(torn, np.inf)
    assert whole.is_watertight and whole.is_winding_consistent and whole.volume > 0
    assert close_holes(whole, np.inf) is whole


def two_cubes() -> trimesh.Trimesh:
    """Two cubes that share an edge, which has four faces; one face is there twice."""
    a, b = trimesh.creation.box((1, 1, 1)), trimesh.creation.box((1, 1, 1))
    b.apply_translation([1.0, 1.0, 0.0])
    both = trimesh.util.concatenate([a, b])
    both.merge_vertices()
    return trimesh.Trimesh(both.vertices, np.concatenate([both.faces, both.faces[:1]]), process=False)


@pytest.mark.parametrize("hollow", [False, True])
def test_sheets_that_touch_are_taken_apart_and_stay_closed(hollow):
    mesh = two_cubes()
    if hollow:
        mesh.invert()
    counts = np.unique(np.sort(mesh.edges, axis=1), axis=0, return_counts=True)[1]
    assert counts.max() > 3 and not mesh.is_watertight
    mended = repair(mesh)
    assert (np.unique(np.sort(mended.edges, axis=1), axis=0, return_counts=True)[1] == 2).all()
    assert mended.is_watertight and abs(mended.volume) == pytest.approx(2.0)
    assert len(mended.split()) == 2
    assert len(mended.vertices) == 16


def test_repair_leaves_a_manifold_as_it_is(bumpy):
    mended = repair(bumpy)
    assert len(mended.vertices) == len(bumpy.vertices) and mended.is_watertight
    assert np.array_equal(mended.triangles, bumpy.triangles)


def test_a_flap_on_an_edge_comes_off():
    mesh = ball(1.0)
    tip = len(mesh.vertices)
    flap = trimesh.Trimesh(
        np.concatenate([mesh.vertices, [3.0 * mesh.triangles_center[0]]]),
        np.concatenate([mesh.faces, [[*mesh.faces[0, :2], tip]]]),
        process=False,
    )
    mended = repair(flap)
    assert len(mended.split(only_watertight=False)) == 2 and keep_largest(mended, 1).is_watertight


def test_self_intersections_are_counted():
    pytest.importorskip("open3d", exc_type=ImportError)
    crossing = trimesh.util.concatenate([trimesh.creation.icosphere(2), ball(0.7, 1.03)])
    ends = np.repeat(crossing.edges_unique, len(crossing.faces), axis=0)
    corners = np.tile(crossing.faces, (len(crossing.edges_unique), 1))
    apart = (corners[:, :, None] != ends[:, None]).all(axis=(1, 2))
    ends, corners = ends[apart], corners[apart]
    origin, way = crossing.vertices[ends[:, 0]], np.diff(crossing.vertices[ends], axis=1)[:, 0]
    system = np.stack(
        [way, *(crossing.vertices[corners[:, :1]] - crossing.vertices[corners[:, 1:]]).swapaxes(0, 1)], -1
    )
    regular = np.abs(np.linalg.det(system)) > 1e-12
    start = (crossing.vertices[corners[:, 0]] - origin)[regular]
    t, u, v = np.linalg.solve(system[regular], start[..., None])[..., 0].T
    inside = (t > 0) & (t < 1) & (u > 0) & (v > 0) & (u + v < 1)
    faces = np.tile(np.arange(len(crossing.faces)), len(crossing.edges_unique))[apart][regular]
    assert self_intersections(crossing) == len(np.unique(faces[inside])) > 20
    assert self_intersections(trimesh.util.concatenate([ball(1.0), ball(0.9), ball(1.0, 2.5)])) == 0
    folded = ball(1.0)
    folded.vertices[0] *= -1.2
    assert self_intersections(folded) > 0
