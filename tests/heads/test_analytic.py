"""The analytic field tells the truth about itself."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from gazenerf.errors import UserError
from gazenerf.geometry import Camera, Gaze
from gazenerf.heads.analytic import IRIS_COSINE, AnalyticField
from gazenerf.heads.interface import BoundField


def test_it_is_a_bound_field():
    assert isinstance(AnalyticField(), BoundField)


@pytest.mark.parametrize("part", ["face", "eyes", "head"])
def test_density_is_half_on_the_rendered_surface_and_grows_inward(part):
    field = AnalyticField(sharpness=0.1)
    view = field.render_geometry(Camera.orbit(0.4, 0.2, size=48), part, normals=True)
    rays_o, rays_d = view.camera.rays()
    seen = np.isfinite(view.depth)
    assert 10 < seen.sum() < seen.size and np.array_equal(seen, view.opacity > 0.5)
    assert view.normals is not None and np.array_equal(seen, np.isfinite(view.normals).all(-1))
    points = (rays_o + np.nan_to_num(view.depth)[..., None] * rays_d)[seen]
    normals = view.normals[seen]
    assert np.allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-5)
    assert ((normals * rays_d[seen]).sum(1) < 0).all()

    own = [torch.from_numpy(points + step * normals) for step in (0.0, 0.004, -0.004)]
    there, outside, inside = (field.density(p, part).numpy() for p in own)
    if part != "head":
        assert np.allclose(there, 0.5 * field.solid, atol=0.01 * field.solid)
    assert (outside < there).all() and (inside > there).all()


def test_density_gradient_points_against_the_normal():
    field = AnalyticField(sharpness=0.1)
    view = field.render_geometry(Camera.neutral(size=24), "face", normals=True)
    rays_o, rays_d = view.camera.rays()
    seen = np.isfinite(view.depth)
    points = torch.from_numpy((rays_o + np.nan_to_num(view.depth)[..., None] * rays_d)[seen]).requires_grad_()
    (gradient,) = torch.autograd.grad(field.density(points, "face").sum(), points)
    assert view.normals is not None
    cosine = torch.nn.functional.cosine_similarity(-gradient, torch.from_numpy(view.normals[seen]).double())
    assert cosine.min() > 0.9999


def test_iris_centre_lies_along_the_gaze():
    gaze = Gaze.from_degrees(10.0, 20.0)
    field = AnalyticField(gaze)
    camera = Camera.neutral(size=1024)
    image = field.render(camera, ("eyes",)).images["eyes"]
    view = field.render_geometry(camera, "eyes")
    rays_o, rays_d = camera.rays()
    points = rays_o + np.nan_to_num(view.depth)[..., None] * rays_d
    dark = np.isfinite(view.depth) & (image[..., 0] < 0.5) & (points[..., 0] > 0)
    directions = (points[dark] - field.eyes[0].centre) / field.eyes[0].radii[0]
    assert (directions @ gaze.vector()).min() > IRIS_COSINE - 0.01
    mean = Gaze.from_vector(directions.mean(axis=0))
    assert np.rad2deg(mean.angle_to(gaze)) < 2.0


def test_faults_are_where_they_were_put():
    field = AnalyticField(
        face_offset=(0.1, 0.0, 0.0), face_scale=1.5, eye_offset=(0.0, 0.05, 0.0), gaze_error=(0.1, -0.2)
    )
    plain = AnalyticField()
    assert np.allclose(field.face.centre - plain.face.centre, [0.1, 0, 0])
    assert np.allclose(field.face.radii / plain.face.radii, 1.5)
    assert np.allclose(field.eyes[0].centre - plain.eyes[0].centre, [0, 0.05, 0])
    assert np.allclose(field.eyes[1].centre, plain.eyes[1].centre)
    assert (field.seen_gaze.pitch, field.seen_gaze.yaw) == pytest.approx((0.1, -0.2))
    assert (field.gaze.pitch, field.gaze.yaw) == (0.0, 0.0)


def test_an_unknown_part_is_refused():
    with pytest.raises(UserError, match="unknown part"):
        AnalyticField().density(torch.zeros(1, 3), "nose")  # pyright: ignore[reportArgumentType]
