"""Surface metrics on samples whose distance, motion and centre are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gazenerf.evaluation.face_crop import face_crop
from gazenerf.export.mesh.sphere_fit import fit_sphere
from gazenerf.geometry import Camera
from gazenerf.geometry.gaze import rotation_y
from gazenerf.heads.analytic import AnalyticField
from gazenerf.viz.metrics.surface_agreement import surface_agreement, surface_samples
from gazenerf.viz.metrics.surface_fit import Alignment, SurfaceSamples, align
from gazenerf.viz.metrics.surfaces import (
    NAMES,
    measure_surfaces,
    surface_errors,
)
from gazenerf.viz.reference.views import ReferenceView
from gazenerf.viz.selftest.exact_scene import SmoothScene, scene_mesh

TURN = rotation_y(np.deg2rad(1.5))
SHIFT = np.array([0.02, -0.01, 0.015])


def sphere(radius: float, count: int, seed: int) -> SurfaceSamples:
    """Random samples of a sphere about the origin."""
    normals = np.random.default_rng(seed).normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return SurfaceSamples(radius * normals, normals)


def ellipsoid(count: int, seed: int) -> SurfaceSamples:
    """Samples of the front of an ellipsoid, which fixes all seven numbers of a similarity."""
    solid = AnalyticField().face
    ball = sphere(1.0, count, seed).points
    points = solid.centre + ball[ball[:, 2] > -0.2] * solid.radii
    return SurfaceSamples(points, solid.normals(points))


@pytest.mark.parametrize("scale", [1.0, 1.03, 0.98])
def test_align_recovers_a_motion_and_a_scale(scale):
    fixed = ellipsoid(8000, 0)
    known = Alignment(TURN, SHIFT, scale)
    # Samples of the same surface, but other ones, laid where the known motion brings them back from.
    other = ellipsoid(8000, 1)
    moving = SurfaceSamples((other.points - SHIFT) @ TURN / scale, other.normals @ TURN)
    found = align(moving, fixed, scale=True)
    assert found.scale == pytest.approx(scale, abs=5e-4)
    assert np.abs(found.translation - SHIFT).max() < 1e-3, "0.1 mm"
    assert np.rad2deg(found.angle) == pytest.approx(1.5, abs=0.05)
    assert np.abs(found.apply(moving.points) - known.apply(moving.points)).max() < 2e-3
    assert np.linalg.det(found.rotation) == pytest.approx(1.0)
    rigid = align(moving, fixed)
    assert rigid.scale == 1.0
    apart = np.abs(rigid.apply(moving.points) - known.apply(moving.points)).max()
    assert apart < 2e-3 if scale == 1.0 else apart > 5e-3, "a rigid fit leaves a size error"


def test_a_sphere_inside_another_reads_the_gap_both_ways():
    inner, outer = sphere(1.0, 20_000, 0), sphere(1.015, 20_000, 1)
    apart = surface_agreement(outer, inner, 0.1)
    assert apart.accuracy_mm == pytest.approx(1.5, abs=0.05)
    assert apart.completeness_mm == pytest.approx(1.5, abs=0.05)
    assert apart.chamfer_mm == pytest.approx(1.5, abs=0.05)
    assert apart.normal_consistency > 0.999
    assert apart.f_score == {"1": 0.0, "2": 1.0, "5": 1.0}
    assert surface_agreement(outer, inner, 0.2).chamfer_mm == pytest.approx(3.0, abs=0.1), "units count"


def test_what_one_side_lacks_is_told_from_what_it_has_too_much():
    whole = sphere(1.0, 20_000, 0)
    front = whole.points[:, 2] > 0.0
    half = SurfaceSamples(whole.points[front], whole.normals[front])
    lacking = surface_agreement(half, sphere(1.0, 20_000, 1), 0.1)
    assert lacking.accuracy_mm < 0.1 and lacking.completeness_mm > 10.0
    assert 0.6 < lacking.f_score["1"] < 0.75, "precision 1, recall a half"
    inside_out = SurfaceSamples(whole.points, -whole.normals)
    assert surface_agreement(inside_out, whole, 0.1).normal_consistency == pytest.approx(-1.0)


def test_a_sphere_of_known_radius_from_a_front_with_noise_and_some_lid():
    rng = np.random.default_rng(0)
    truth = np.array([0.3, 0.1, 0.7])
    front = sphere(0.12, 4000, 0).points
    front = truth + front[front[:, 2] > 0.06]
    assert np.abs(fit_sphere(front, radius=0.12).centre - truth).max() < 1e-6
    noisy = front + rng.normal(0.0, 0.002, front.shape)
    assert np.abs(fit_sphere(noisy, radius=0.12).centre - truth).max() < 2e-3
    lid = np.column_stack([rng.uniform(0.2, 0.4, 150), rng.uniform(0.15, 0.2, 150), np.full(150, 0.85)])
    assert np.abs(fit_sphere(np.concatenate([front, lid]), radius=0.12).centre - truth).max() < 1e-3


def view(size: int) -> ReferenceView:
    """The analytic field's own view in the shape of a reference."""
    camera = Camera.orbit(0.2, size=size)
    field = AnalyticField()
    seen = field.render_geometry(camera, normals=True)
    assert seen.normals is not None
    parts = np.where(np.isfinite(seen.depth), field._hit(camera, "head")[2] + 1, 0).astype(np.uint8)
    return ReferenceView(camera, seen.depth, seen.normals, parts, "exact")


def test_samples_lie_on_the_surface_and_need_normals():
    exact = view(64)
    samples = surface_samples([exact], 500)
    levels = np.stack([((samples.points - s.centre) / s.radii) ** 2 for s in AnalyticField().solids("head")]).sum(-1)
    assert len(samples.points) == 500 and np.abs(levels - 1.0).min(axis=0).max() < 1e-3
    assert np.linalg.norm(samples.normals, axis=1) == pytest.approx(1.0, abs=1e-4)
    with pytest.raises(ValueError, match="normals"):
        surface_samples([AnalyticField().render_geometry(exact.camera)], 500)


def test_too_few_samples_are_not_measured():
    mesh = scene_mesh(AnalyticField(), 2)
    exact, tiny = view(128), view(16)
    gone = AnalyticField(face_scale=0.01).render_geometry(exact.camera, "face", normals=True)
    for field, reference in ((tiny, tiny), (gone, exact)):
        found = measure_surfaces([field], [reference], mesh, 0.1)
        assert set(found) == set(NAMES) and np.isnan(list(found.values())).all()
    assert np.isfinite(list(measure_surfaces([exact], [exact], mesh, 0.1).values())).all()


def test_eyes_too_small_to_fit_are_not_measured_but_the_rest_is():
    mesh = scene_mesh(AnalyticField(), 2)
    small = view(32)
    assert 0 < (small.parts == 2).sum() < 40
    found = measure_surfaces([small], [small], mesh, 0.1)
    assert np.isnan(found["eye_centre_mm"]) and found["chamfer_mm"] == pytest.approx(0.0, abs=0.3)


def test_the_face_crop_judges_the_face_and_the_rest_does_not_move_it():
    """A dent in the chin's side of the head, outside the ball, moves the whole but not the face."""
    scene = SmoothScene()
    mesh, exact = scene_mesh(scene, 3), view(128)
    points = exact.camera.unproject(np.nan_to_num(exact.depth))
    crop = face_crop(mesh)
    assert crop is not None
    outside, inside = ~crop.contains(points) & np.isfinite(exact.depth), crop.contains(points)
    assert outside.sum() > 200 and inside.sum() > 1000
    for where, moved in ((outside, "chamfer_mm"), (inside, "face_chamfer_mm")):
        dented = replace(exact, depth=np.where(where, exact.depth - 0.03, exact.depth).astype(np.float32))
        found = measure_surfaces([dented], [exact], mesh, 0.1)
        assert found[moved] > 0.3
        if where is outside:
            assert found["face_chamfer_mm"] < 0.1
        else:
            assert 1.5 < found["face_accuracy_mm"] < 3.1 and found["face_chamfer_aligned_mm"] < 1.0
    bare = replace(mesh, landmarks={})
    assert np.isnan(measure_surfaces([exact], [exact], bare, 0.1)["face_chamfer_mm"])


def test_errors_need_two_views_and_grow_with_disagreement():
    mesh, views = scene_mesh(AnalyticField(), 3), [view(64), view(64)]
    assert np.isnan(surface_errors(views[:1], views[:1], mesh, 0.1)["chamfer_mm"])
    alike = surface_errors(views, views, mesh, 0.1)["surface_accuracy_mm"]
    off = replace(views[1], depth=views[1].depth + np.float32(0.05))
    apart = surface_errors([views[0], off], views, mesh, 0.1)["surface_accuracy_mm"]
    assert apart > 10 * max(alike, 0.01)
