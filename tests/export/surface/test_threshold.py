"""A threshold is chosen by what the field renders and the surface lacks, not by the median alone."""

from __future__ import annotations

import numpy as np
import trimesh

from gazenerf.export import MeshOptions, extract_part
from gazenerf.export.formats.files import sidecar
from gazenerf.export.surface.densities import DensityGrid
from gazenerf.export.surface.threshold import NEAR_MM, choose_threshold, judge
from gazenerf.geometry import Camera
from gazenerf.heads.analytic import AnalyticField, Ellipsoid
from gazenerf.heads.interface import GeometryView

EAR = Ellipsoid(np.array([0.9, 0.0, 0.0]), np.full(3, 0.5))


class Eared(AnalyticField):
    """A face with an ear in its rendered depth."""

    def render_geometry(self, camera, part="head", normals=False):
        view = super().render_geometry(camera, part, False)
        hit = EAR.intersect(*camera.rays())
        depth = np.fmin(view.depth, np.where(np.isfinite(hit), hit, np.nan)).astype(np.float32)
        return GeometryView(camera, np.isfinite(depth).astype(np.float32), depth)


def solid(shape: Ellipsoid, outward: float) -> trimesh.Trimesh:
    ball = trimesh.creation.icosphere(5)
    ball.vertices = shape.centre + ball.vertices * (shape.radii + outward)
    return ball


def surface(level: float) -> trimesh.Trimesh:
    """Nearer to the truth with every level, but from 40 on without the ear."""
    away = 0.2 / level
    head = solid(AnalyticField().face, away)
    return head if level > 40.0 else trimesh.util.concatenate([head, solid(EAR, away)])


def test_a_part_that_pictures_show_is_not_given_up_for_a_smaller_median():
    grid = DensityGrid(np.full((2, 2, 2), 200.0, np.float32), np.zeros(3), 1.0, 8)
    chosen = choose_threshold(Eared(), "face", grid, "auto", surface)
    by_median = min(chosen.tried, key=lambda found: found.depth_error_mm)
    assert by_median.level > 40.0 >= chosen.level
    assert by_median.depth_error_mm < chosen.depth_error_mm < NEAR_MM
    assert by_median.missing > chosen.missing + 0.03


def test_a_surface_is_judged_both_ways():
    camera = Camera.neutral(48)
    views = [(camera, AnalyticField().render_geometry(camera, "face").depth)]
    near, half = solid(AnalyticField().face, -0.01), solid(AnalyticField().face, 0.0)
    found = judge(5.0, near, views, 0.1)
    assert 0.9 < found.depth_error_mm < 1.6 and found.missing < 0.3
    cut = half.submesh([half.triangles_center[:, 0] > 0.0], append=True)
    lacking = judge(5.0, cut, views, 0.1)
    assert lacking.depth_error_mm < 0.1 and 0.4 < lacking.missing < 0.6, "the median sees nothing of it"


def test_the_sidecar_says_what_is_missing():
    bound = AnalyticField(sharpness=0.02)
    found = extract_part(bound, "face", MeshOptions(resolution=128, colours=False))
    facts = sidecar(found, bound)
    assert found.threshold is not None
    assert facts["share_of_rendered_depth_missing"] == found.threshold.missing < 0.05
    assert all("share_of_rendered_depth_missing" in tried for tried in facts["thresholds_tried"])
