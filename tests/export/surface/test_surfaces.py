"""Surfaces from depth in pictures: an independent second opinion."""

from __future__ import annotations

import json
import sys

import numpy as np
import pytest

from gazenerf.errors import UserError
from gazenerf.export import MeshOptions, extract_part, mesh_subject
from gazenerf.heads.analytic import AnalyticField, AnalyticHead

BOUND = AnalyticField(sharpness=0.1)


def distances(extracted) -> np.ndarray:
    """How far the vertices lie from the true surface, world units."""
    vertices = np.asarray(extracted.mesh.vertices)
    away = []
    for solid in BOUND.solids(extracted.part):
        level = np.linalg.norm((vertices - solid.centre) / solid.radii, axis=1)
        steepness = np.linalg.norm((vertices - solid.centre) / solid.radii**2, axis=1) / level
        away.append(np.abs(level - 1.0) / steepness)
    return np.min(away, axis=0)


@pytest.fixture
def open3d():
    try:
        import open3d  # noqa: F401
    except (ImportError, OSError) as error:
        pytest.skip(f"open3d cannot be loaded: {error}")


@pytest.mark.parametrize("part", ["face", "eyes"])
@pytest.mark.parametrize(("surface", "bias"), [("tsdf", 0.25), ("poisson", 0.02)])
def test_fused_surfaces_are_the_true_ones(open3d, part, surface, bias):
    extracted = extract_part(BOUND, part, MeshOptions(resolution=64, surface=surface, colours=False, smoothing=0))
    away = distances(extracted) / extracted.spacing
    assert away.max() < 1.0 and away.mean() < bias
    assert extracted.mesh.is_watertight and extracted.mesh.volume > 0
    true = sum(4 / 3 * np.pi * solid.radii.prod() for solid in BOUND.solids(part))
    assert extracted.mesh.volume == pytest.approx(true, rel=0.03)
    assert len(extracted.mesh.split()) == (2 if part == "eyes" else 1)


def test_a_fused_surface_is_written_without_a_threshold(open3d, tmp_path):
    settings: dict = {"resolution": 32, "colours": False, "formats": ("ply",), "parts": ("face",), "volumes": ("npz",)}
    mesh_subject(AnalyticHead(lambda gaze: BOUND), tmp_path, MeshOptions(surface="poisson", **settings))
    about = json.loads((tmp_path / "face.json").read_text())
    assert about["threshold_per_world_unit"] is None and "Poisson" in about["steps"][0]
    assert (tmp_path / "face.npz").exists()


def test_without_open3d_the_fix_is_named_and_isosurfaces_go_on(monkeypatch):
    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.raises(UserError, match="pip install open3d"):
        extract_part(BOUND, "face", MeshOptions(resolution=32, surface="tsdf", colours=False))
    assert len(extract_part(BOUND, "face", MeshOptions(resolution=32, threshold=100.0, colours=False)).mesh.faces)


def test_nothing_to_see_is_one_line(open3d):
    bound = AnalyticField()
    bound.box = np.array([[3.0, 3.0, 3.0], [4.0, 4.0, 4.0]])
    with pytest.raises(UserError, match="misses the head"):
        extract_part(bound, "face", MeshOptions(resolution=32, surface="tsdf", colours=False))
    with pytest.raises(UserError, match="isosurface, tsdf, poisson"):
        extract_part(bound, "face", MeshOptions(surface="splats"))
