"""What a mesh lacks of the pictures and has beyond them is counted, named and warned about."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
import trimesh

from gazenerf.export import MeshOptions, extract_part
from gazenerf.export.formats.files import sidecar
from gazenerf.export.surface.coverage import CAP_MM, RenderedDepth, coverage
from gazenerf.heads.analytic import AnalyticField
from tests.export.surface.eared import EAR, Eared, solid

FACE = AnalyticField().face


@pytest.fixture(scope="module")
def rendered() -> RenderedDepth:
    return RenderedDepth.of(Eared(), "face")


def test_the_right_surface_lacks_nothing_and_says_nothing(rendered):
    found = coverage(trimesh.util.concatenate([solid(FACE, 0.0), solid(EAR, 0.0)]), rendered)
    assert found.depth_error_mm < 0.1 and found.missing == 0.0 and found.unrendered == 0.0
    assert found.lost == () and found.warning("face") is None


def test_a_surface_beside_the_depth_is_as_far_as_it_is(rendered):
    found = coverage(trimesh.util.concatenate([solid(FACE, -0.01), solid(EAR, -0.01)]), rendered)
    assert 0.9 < found.depth_error_mm < 1.6 and found.missing == 0.0
    far = coverage(trimesh.util.concatenate([solid(FACE, -0.03), solid(EAR, -0.03)]), rendered)
    assert far.missing > 0.9


def test_a_lost_ear_is_named_with_its_size_and_side(rendered):
    found = coverage(solid(FACE, 0.0), rendered)
    assert found.depth_error_mm < 0.1, "the median sees nothing of it"
    (lost,) = found.lost
    beyond = EAR.centre[0] + EAR.radii[0] - FACE.radii[0]
    assert lost.centre[0] > FACE.radii[0] and beyond > 0.3
    assert 2.0 < lost.area_cm2 < 79.0, "less than the whole ear's disc"
    said = found.warning("face")
    assert said is not None and f"{lost.area_cm2:.1f} cm2" in said and "left" in said and "right" not in said


def test_an_ear_that_no_picture_shows_is_counted_the_other_way():
    found = coverage(
        trimesh.util.concatenate([solid(FACE, 0.0), solid(EAR, 0.0)]), RenderedDepth.of(AnalyticField(), "face")
    )
    assert found.missing == 0.0 and found.unrendered > 0.05
    assert found.warning("face") is not None and "not in the field's pictures" in str(found.warning("face"))


def test_half_a_mesh_lacks_half(rendered):
    whole = trimesh.util.concatenate([solid(FACE, 0.0), solid(EAR, 0.0)])
    found = coverage(whole.submesh([whole.triangles_center[:, 0] < 0.0], append=True), rendered)
    assert 0.4 < found.missing < 0.7 and found.lost[0].centre[0] > 0.0
    assert 0.3 * CAP_MM < found.cost_mm < 2.0 * CAP_MM


def test_a_mesh_that_nothing_is_rendered_of_is_all_wrong():
    away = solid(FACE, 0.0).apply_translation([0.0, 500.0, 0.0])
    found = coverage(away, RenderedDepth.of(AnalyticField(), "face"))
    assert np.isnan(found.depth_error_mm) and found.missing == 1.0 and found.warning("face")


def test_the_sidecar_says_both_and_extraction_warns_of_an_ear_the_density_lacks():
    options = MeshOptions(resolution=64, colours=False)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        whole = extract_part(AnalyticField(sharpness=0.02), "face", options)
    with pytest.warns(UserWarning, match="subject's left"):
        lacking = extract_part(Eared(sharpness=0.02), "face", options)
    for found, bound in ((whole, AnalyticField()), (lacking, Eared())):
        facts = sidecar(found, bound)
        assert facts["share_of_rendered_depth_missing"] == found.coverage.missing
        assert facts["share_of_surface_not_rendered"] == found.coverage.unrendered
        assert len(facts["lost_parts"]) == len(found.coverage.lost)
        for tried in facts["thresholds_tried"]:
            assert {"share_of_rendered_depth_missing", "share_of_surface_not_rendered"} <= set(tried)
    assert whole.coverage.missing < 0.05 < lacking.coverage.missing
