"""A threshold is chosen by what the field renders and the surface lacks and the other way round, not by the median."""

from __future__ import annotations

import numpy as np
import trimesh

from gazenerf.export.surface.coverage import NEAR_MM, RenderedDepth
from gazenerf.export.surface.densities import DensityGrid
from gazenerf.export.surface.threshold import choose_threshold
from gazenerf.heads.analytic import AnalyticField
from tests.export.surface.eared import EAR, Eared, solid

GRID = DensityGrid(np.full((2, 2, 2), 200.0, np.float32), np.zeros(3), 1.0, 8)


def chosen(surface, bound):
    found = choose_threshold("face", GRID, "auto", surface, lambda: RenderedDepth.of(bound, "face"))
    at = next(tried.coverage for tried in found.tried if tried.level == found.level)
    nearest = min(found.tried, key=lambda tried: tried.coverage.depth_error_mm)
    return found.level, at, nearest.level, nearest.coverage


def test_a_part_that_pictures_show_is_not_given_up_for_a_smaller_median():
    def surface(level: float) -> trimesh.Trimesh:
        """Nearer to the truth with every level, but from 40 on without the ear."""
        head = solid(AnalyticField().face, 0.2 / level)
        return head if level > 40.0 else trimesh.util.concatenate([head, solid(EAR, 0.2 / level)])

    level, ours, other, by_median = chosen(surface, Eared())
    assert other > 40.0 >= level
    assert by_median.depth_error_mm < ours.depth_error_mm < NEAR_MM
    assert by_median.missing > ours.missing + 0.03


def test_surface_that_no_picture_shows_is_not_taken_for_a_smaller_median():
    def surface(level: float) -> trimesh.Trimesh:
        """Nearer to the truth with every level, but from 40 on with an ear that is not there."""
        head = solid(AnalyticField().face, 0.2 / level)
        return trimesh.util.concatenate([head, solid(EAR, 0.0)]) if level > 40.0 else head

    level, ours, other, by_median = chosen(surface, AnalyticField())
    assert other > 40.0 >= level
    assert ours.unrendered < 0.01 and by_median.unrendered > 0.03
