"""An analytic face whose pictures show an ear at the subject's left, and solids to mesh it with."""

from __future__ import annotations

import numpy as np
import trimesh

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
    """A closed mesh of an ellipsoid whose radii are larger by so much, world units."""
    ball = trimesh.creation.icosphere(5)
    ball.vertices = shape.centre + ball.vertices * (shape.radii + outward)
    return ball
