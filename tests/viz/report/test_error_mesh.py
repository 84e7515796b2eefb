"""The coloured error mesh reads injected distances back, and its file opens."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from gazenerf.heads.analytic import AnalyticField
from gazenerf.viz.pictures.surface_colours import GIVE_UP_MM, GREY, signed_distance
from gazenerf.viz.report.error_mesh import (
    BESIDE_M,
    FILE,
    error_mesh,
    write_error_mesh,
)
from gazenerf.viz.selftest.faults import moved_mesh, scene_mesh


@pytest.fixture(scope="module")
def larger():
    """The field's head 2 % larger than the reference's."""
    field = AnalyticField(face_scale=1.02, sharpness=0.2)
    return error_mesh(field, scene_mesh(AnalyticField(), 4), resolution=64, threshold=100.0)


def test_an_exact_field_is_white_and_a_larger_one_stands_out_by_its_size(larger):
    exact = error_mesh(AnalyticField(sharpness=0.2), scene_mesh(AnalyticField(), 4), resolution=64, threshold=100.0)
    assert np.nanpercentile(np.abs(exact.field_mm), 90) < 0.3
    radii = AnalyticField().face.radii
    expected = 0.02 * 100 * radii
    shell = larger.field_mm[np.isfinite(larger.field_mm)]
    assert expected.min() - 0.3 < np.median(shell) < expected.max() + 0.3
    assert larger.facts()["field"]["50_percentile_mm"] == pytest.approx(np.median(shell))
    top = np.argmax(larger.field.vertices[:, 1])
    assert larger.field_mm[top] == pytest.approx(100 * 0.02 * radii[1], abs=0.3)
    red, _, blue, _ = larger.field.visual.vertex_colors[top]
    assert blue > red, "what stands out is blue"
    reference_top = np.argmax(larger.reference.vertices[:, 1])
    assert larger.reference_mm[reference_top] == pytest.approx(100 * 0.02 * radii[1], abs=0.3)


def test_what_has_no_partner_is_grey_and_not_counted():
    far = moved_mesh(scene_mesh(AnalyticField(), 3), (0.0, 0.0, 500.0))
    error = error_mesh(AnalyticField(), far, resolution=48, threshold=100.0)
    assert np.isnan(error.field_mm).all() and error.facts()["field"] == {
        "vertices": len(error.field_mm), "compared": 0, "5_percentile_mm": None, "50_percentile_mm": None,
        "95_percentile_mm": None,
    }  # fmt: skip
    assert (error.field.visual.vertex_colors[:, :3] == GREY).all() and GIVE_UP_MM < 500.0


def test_distances_are_signed_also_beside_an_open_surface():
    plane = trimesh.Trimesh([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], [[0, 1, 2], [0, 2, 3]], process=False)
    found = signed_distance(np.array([[0.0, 0.0, 0.5], [0.3, -0.2, -0.25]]), plane)
    assert found == pytest.approx([0.5, -0.25])


def test_the_file_holds_both_in_metres_side_by_side(larger, tmp_path):
    facts = write_error_mesh(larger, AnalyticField(), tmp_path)
    scene = trimesh.load(tmp_path / FILE)
    assert facts["file"] == FILE and facts["units"] == "metres"
    extents = {name: scene.geometry[scene.graph[name][1]].extents for name in ("field", "reference")}
    assert extents["reference"][1] == pytest.approx(0.22, abs=1e-3)
    assert extents["field"][1] == pytest.approx(0.22 * 1.02, abs=2e-3)
    assert scene.graph["reference"][0][0, 3] == pytest.approx(BESIDE_M)
