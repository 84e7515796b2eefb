"""The benchmark compares the same surface, sparse and dense."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import mesh
from gazenerf.export.surface.densities import DensityGrid
from gazenerf.heads.analytic import AnalyticField


@pytest.fixture(scope="module")
def bound() -> AnalyticField:
    return AnalyticField(sharpness=0.1)


def test_the_surfaces_are_the_same_and_the_counts_are_the_grids(bound):
    found = mesh.compare(bound, "face", 80, 100.0)
    assert found["vertices_apart"] < mesh.SAME
    assert found["dense_queries"] == 80**3
    assert found["times_fewer"] == pytest.approx(80**3 / found["queries"]) and found["times_fewer"] > 3


def test_a_wrong_sparse_grid_is_caught(bound, monkeypatch):
    right = mesh.refine_density

    def wrong(*args):
        grid = right(*args)
        values = grid.values.copy()
        values[40:] *= 0.99
        return DensityGrid(values, grid.origin, grid.spacing, grid.queries)

    monkeypatch.setattr(mesh, "refine_density", wrong)
    with pytest.raises(AssertionError, match="units apart"):
        mesh.compare(bound, "face", 80, 100.0)


def test_everything_is_extracted_and_counted(bound):
    found = mesh.extract(bound, 64)
    assert [found[part]["components"] for part in mesh.PARTS] == [1, 2]
    assert all(found[part]["watertight"] for part in mesh.PARTS)
    assert all(found[part]["self_intersecting_faces"] in (0, None) for part in mesh.PARTS)
    assert found["face"]["dense_queries"] == 64**3
    assert found["peak_bytes"] > 2**26
    both = mesh.summed(found, {"face": 1000.0, "eyes": 2000.0})
    points = [found[part]["dense_queries"] for part in mesh.PARTS]
    assert both["dense_seconds_from_rate"] == pytest.approx(points[0] / 1000.0 + points[1] / 2000.0)


def test_the_exponent_is_that_of_a_power_law():
    sizes = [128, 256, 512]
    assert mesh.exponent(sizes, [int(7 * n**2.0) for n in sizes]) == pytest.approx(2.0, abs=1e-3)
    assert np.isfinite(mesh.exponent([64, 128], [10, 20]))
