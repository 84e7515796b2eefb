"""Meshes of a field whose surfaces are known exactly."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from scipy.ndimage import gaussian_filter, label

from gazenerf.errors import UserError
from gazenerf.export import MeshOptions, extract_part, mesh_subject
from gazenerf.export.mesh.rays import _cast_vtk, cast_rays
from gazenerf.export.surface.densities import DensityGrid, fill_enclosed, grid_shape, sample_density
from gazenerf.export.surface.isosurface import METHODS, isosurface
from gazenerf.export.surface.refine import refine_density
from gazenerf.heads.analytic import AnalyticField, AnalyticHead

HALF = 100.0


def glb_tree(path: Path) -> dict[str, Any]:
    """The JSON chunk of a GLB file."""
    data = path.read_bytes()
    return json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])


@pytest.fixture(scope="module")
def bound() -> AnalyticField:
    return AnalyticField()


@pytest.mark.parametrize("method", METHODS)
def test_the_surface_lies_within_a_tenth_of_a_voxel(bound, method):
    soft = AnalyticField(sharpness=0.2)
    grid = sample_density(soft, "face", soft.box, 96)
    mesh = isosurface(grid, HALF, method)
    radii = soft.face.radii
    level = np.linalg.norm(np.asarray(mesh.vertices) / radii, axis=1)
    gradient = np.linalg.norm(np.asarray(mesh.vertices) / radii**2, axis=1) / level
    error = (level - 1.0) / gradient
    assert np.sqrt((error**2).mean()) < 0.1 * grid.spacing
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(4 / 3 * np.pi * radii.prod(), rel=0.005)


def test_refined_and_dense_grids_give_the_same_surface_for_fewer_queries(bound):
    soft = AnalyticField(sharpness=0.1)
    dense = sample_density(soft, "head", soft.box, 128)
    refined = refine_density(soft, "head", soft.box, 128, (HALF, HALF))
    a, b = isosurface(dense, HALF), isosurface(refined, HALF)
    assert len(a.faces) == len(b.faces)
    assert np.abs(np.sort(a.vertices, axis=0) - np.sort(b.vertices, axis=0)).max() < 1e-5
    assert refined.queries * 4 < dense.queries


def test_eyes_come_out_as_two_spheres_of_the_right_size(bound):
    bound = AnalyticField(sharpness=0.2)
    extracted = extract_part(bound, "eyes", MeshOptions(resolution=128, colours=False))
    pieces = extracted.mesh.split()
    assert len(pieces) == 2
    for piece, eye in zip(sorted(pieces, key=lambda p: -p.centroid[0]), bound.eyes, strict=True):
        away = np.linalg.norm(np.asarray(piece.vertices) - eye.centre, axis=1)
        assert np.abs(piece.centroid - eye.centre).max() * 100 < 0.1  # mm
        assert abs(away.mean() - eye.radii[0]) * 100 < 0.1
    assert extracted.threshold.how == "auto" and extracted.threshold.level == 96.0
    assert extracted.coverage.depth_error_mm < 0.1


def test_caves_are_filled_but_eye_sockets_are_not():
    axis = np.linspace(-1, 1, 41)
    radius = np.sqrt(sum(a**2 for a in np.meshgrid(axis, axis, axis, indexing="ij")))
    shell = np.where((radius < 0.9) & (radius > 0.6), 10.0, 0.0).astype(np.float32)
    socket = np.zeros_like(shell)
    socket[20:24, 20:24, 30:] = 10.0
    shell[20:24, 20:24, 30:] = 0.0
    grid = DensityGrid(shell, np.full(3, -1.0), 0.05, 0)
    leaking = fill_enclosed(grid, None, 5.0)
    assert leaking.values[20, 20, 20] == 0.0
    filled = fill_enclosed(grid, DensityGrid(socket, grid.origin, 0.05, 0), 5.0)
    assert filled.values[20, 20, 20] > 5.0
    assert filled.values[21, 21, 36] == 0.0


@pytest.mark.parametrize("seed", range(4))
def test_filling_cut_down_grids_is_filling_whole_ones(seed):
    """A reference on whole grids; the eyes have a smaller grid of their own."""
    rng = np.random.default_rng(seed)
    face, eyes = (gaussian_filter(rng.normal(size=(30, 34, 28)), 1.5) for _ in range(2))
    face = (face / face.std() + 0.8).astype(np.float32)
    face[:4], face[25:], face[:, :3] = -1.0, -1.0, -1.0
    face[:, :, :5] = -1.0 if seed % 2 else face[:, :, :5]  # else it leaves the box
    whole = np.zeros_like(face)
    low, high = np.array([6, 5, 8]), np.array([20, 22, 24])
    window = tuple(slice(a, b) for a, b in zip(low, high, strict=True))
    whole[window] = (eyes / eyes.std())[window]
    wall = (face > 0.4) | (whole > 0.4)
    spaces, _ = label(~wall)
    rim = np.ones_like(wall)
    rim[1:-1, 1:-1, 1:-1] = False
    expected = np.where(~wall & ~np.isin(spaces, np.unique(spaces[rim & ~wall])), np.float32(0.8), face)
    grid = DensityGrid(face, np.array([0.5, -1.0, 2.0]), 0.1, 7)
    beside = DensityGrid(whole[window], grid.origin + 0.1 * low, 0.1, 3)
    filled = fill_enclosed(grid, beside, 0.4)
    assert filled.values.size < face.size
    meshes = isosurface(filled, 0.4), isosurface(DensityGrid(expected, grid.origin, 0.1, 7), 0.4)
    assert meshes[0].is_watertight and len(meshes[0].faces) == len(meshes[1].faces)
    a, b = (mesh.vertices[np.lexsort(np.round(mesh.vertices, 4).T)] for mesh in meshes)
    assert np.abs(a - b).max() < 1e-5
    assert (expected != face).any()


@pytest.mark.parametrize("seed", range(3))
def test_both_isosurfaces_enclose_the_same_and_face_outward(seed):
    noise = gaussian_filter(np.random.default_rng(seed).normal(size=(24, 30, 36)), 2.5)
    grid = DensityGrid((noise / noise.std()).clip(0).astype(np.float32), np.array([1.0, 2.0, 3.0]), 0.1, 0)
    one, other = (isosurface(grid, 0.5, method) for method in METHODS)
    assert one.is_watertight and other.is_watertight
    assert one.volume == pytest.approx(other.volume, rel=0.01) and one.volume > 0
    assert np.allclose(one.bounds, other.bounds, atol=1e-5)
    inside = int((grid.values > 0.5).sum()) * 0.1**3
    assert one.volume == pytest.approx(inside, rel=0.1)


def test_files_reload_alike_in_metres_with_a_sidecar(bound, tmp_path):
    meshes = mesh_subject(AnalyticHead(), tmp_path, MeshOptions(resolution=48, threshold=HALF)).parts
    for part, extracted in meshes.items():
        expected = np.asarray(extracted.mesh.bounds) * 0.1
        about = json.loads((tmp_path / f"{part}.json").read_text())
        assert np.allclose(about["bounds_metres"], expected) and about["threshold_choice"] == "fixed"
        for kind in ("glb", "ply", "obj"):
            loaded = trimesh.load(tmp_path / f"{part}.{kind}", force="mesh", process=False)
            assert len(loaded.faces) == about["faces"]
            assert np.allclose(loaded.bounds, expected, atol=1e-6)
            if kind == "glb":
                assert loaded.visual.material.metallicFactor == 0.0
                tree = glb_tree(tmp_path / f"{part}.glb")
                primitive = tree["meshes"][0]["primitives"][0]
                assert tree["accessors"][primitive["attributes"]["COLOR_0"]]["count"] == about["vertices"]
            else:
                assert loaded.visual.kind == "vertex"
        ply = trimesh.load(tmp_path / f"{part}.ply", process=False)
        original = np.asarray(extracted.mesh.visual.vertex_colors)
        assert np.array_equal(np.asarray(ply.visual.vertex_colors), original)
    face = trimesh.load(tmp_path / "face.glb", force="mesh", process=False)
    assert face.extents.argmax() == 1
    assert trimesh.load(tmp_path / "eyes.glb", force="mesh").centroid[2] > 0.07


def test_iris_colour_lands_where_the_eye_looks(bound):
    extracted = extract_part(bound, "eyes", MeshOptions(resolution=96))
    vertices, colours = np.asarray(extracted.mesh.vertices), np.asarray(extracted.mesh.visual.vertex_colors)[:, 0]
    left = vertices[:, 0] > 0
    look = (vertices[left] - bound.eyes[0].centre)[:, 2] / 0.12
    assert colours[left][look > 0.95].mean() < 60 < 180 < colours[left][(look < 0.7) & (look > 0.3)].mean()


def test_both_ray_casters_agree(bound):
    mesh = isosurface(sample_density(bound, "face", bound.box, 48), HALF)
    origins = np.tile([0.0, 0.0, 5.0], (20, 1))
    targets = np.random.default_rng(0).uniform(-1.2, 1.2, (20, 3))
    directions = targets - origins
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    fast, slow = cast_rays(mesh, origins, directions), _cast_vtk(mesh, origins, directions)
    assert np.array_equal(np.isnan(fast), np.isnan(slow))
    assert np.nanmax(np.abs(fast - slow)) < 1e-4


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"resolution": 4}, "resolution"),
        ({"threshold": 1e6}, "lower --threshold"),
        ({"threshold": "loud"}, "give auto"),
        ({"formats": ("fbx",)}, "unknown format"),
        ({"parts": ("nose",)}, "unknown part"),
    ],
)
def test_bad_input_is_one_line_and_writes_nothing(bound, tmp_path, settings, message):
    with pytest.raises(UserError, match=message) as caught:
        options: dict = {"resolution": 32, "colours": False, **settings}
        mesh_subject(AnalyticHead(), tmp_path / "out", MeshOptions(**options))
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "out").exists() or not any((tmp_path / "out").iterdir())


def test_existing_files_are_kept_without_overwrite(bound, tmp_path):
    (tmp_path / "face.ply").write_text("mine")
    with pytest.raises(UserError, match="--overwrite"):
        options = MeshOptions(parts=("face",), formats=("ply",), resolution=32, colours=False)
        mesh_subject(AnalyticHead(), tmp_path, options)
    assert (tmp_path / "face.ply").read_text() == "mine"


def test_a_grid_that_cannot_fit_says_how_large_it_would_be(bound, monkeypatch):
    monkeypatch.setattr("gazenerf.export.surface.densities.available_memory", lambda: 2**30)
    with pytest.raises(UserError, match="GiB"):
        grid_shape(bound.box, 512)
