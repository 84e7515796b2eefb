"""Points on a surface: where they lie, how they face, what colour they have."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

import gazenerf.export.appearance.colours
from gazenerf.errors import UserError
from gazenerf.export import MeshOptions, extract_part, mesh_subject
from gazenerf.export.appearance.points import MAX_POINTS, sample_points, write_points
from gazenerf.heads.analytic import AnalyticField, AnalyticHead


@pytest.fixture(autouse=True)
def small_pictures(monkeypatch):
    monkeypatch.setattr(gazenerf.export.appearance.colours, "PICTURE", 192)


def read_ply(path):
    """The vertices of a PLY file, as any reader sees them."""
    import pyvista as pv

    return pv.read(path)


def test_points_lie_on_the_surface_with_its_normals_and_colours(tmp_path):
    bound = AnalyticField(sharpness=0.2)
    options = MeshOptions(resolution=48, threshold=100.0, formats=("ply",), parts=("face",), points=3000)
    mesh_subject(AnalyticHead(lambda gaze: bound), tmp_path, options)
    cloud = read_ply(tmp_path / "face-points.ply")
    points = np.asarray(cloud.points, dtype=np.float64) / 0.1
    assert len(points) == 3000
    assert np.abs(np.linalg.norm(points / bound.face.radii, axis=1) - 1.0).max() < 0.01
    normals = np.asarray(cloud["Normals"] if "Normals" in cloud.array_names else cloud.point_data.active_normals)
    assert (normals * bound.face.normals(points)).sum(axis=1).min() > 0.99
    front = points[:, 2] > 0.5
    wave = 0.5 + 0.25 * np.sin(5.0 * points) * np.cos(3.0 * np.roll(points, 1, axis=-1))
    assert np.abs(np.asarray(cloud["RGB"])[front] / 255.0 - wave[front]).mean() < 0.01


def test_points_are_even_and_the_same_every_time():
    ball = trimesh.creation.icosphere(3)
    first, again = sample_points(ball, 4000), sample_points(ball, 4000)
    assert np.array_equal(first.points, again.points)
    octants = np.bincount((first.points > 0) @ [1, 2, 4], minlength=8)
    assert octants.min() > 400
    assert np.allclose(np.linalg.norm(first.normals, axis=1), 1.0) and first.colours is None


def test_points_without_colours_have_none_in_the_file(tmp_path):
    extracted = extract_part(
        AnalyticField(), "eyes", MeshOptions(resolution=32, threshold=100.0, colours=False, points=50)
    )
    write_points(extracted.points, 0.1, tmp_path / "eyes.ply")
    text = (tmp_path / "eyes.ply").read_bytes()
    assert b"property float nz" in text and b"red" not in text
    assert read_ply(tmp_path / "eyes.ply").n_points == 50


@pytest.mark.parametrize("count", [0, -5, MAX_POINTS + 1])
def test_impossible_counts_are_refused(count):
    with pytest.raises(UserError, match="--points"):
        extract_part(AnalyticField(), "face", MeshOptions(points=count))
