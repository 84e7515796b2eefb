"""Fits of rendered people come close to the truth, from every kind of landmarks, and say what they doubt."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.fit import aligned, angle, surface_errors
from gazenerf.errors import UserError
from gazenerf.photographs.correspondence import table_for
from gazenerf.photographs.fit import Photograph, fit_photographs, refuse_profile
from gazenerf.photographs.irises import find_eyes, openness
from gazenerf.photographs.landmarks import FaceLandmarks
from gazenerf.photographs.overlay import overlay
from gazenerf.photographs.picture_terms import Observed
from gazenerf.photographs.shape_fit import fit_shape


def exact(item, model) -> FaceLandmarks:
    """The standard landmarks where they truly are."""
    points, _ = item.camera.project(item.mesh.vertices[model.landmark_vertices].astype(float))
    return FaceLandmarks(points)


@pytest.fixture(scope="module")
def fitted(model, rendered, landmarks):
    return fit_photographs([Photograph("a.png", rendered[0].image, landmarks[0])], model)[0]


@pytest.fixture
def few_steps(monkeypatch):
    """For what does not depend on how good a fit is."""
    monkeypatch.setattr("gazenerf.photographs.shape_fit.STEPS", 15)
    monkeypatch.setattr("gazenerf.photographs.shape_fit.MORE_STEPS", 5)


def test_pose_gaze_and_surface_come_close(fitted, rendered):
    assert angle(rendered[0].camera, fitted.subject.camera) < 5.0
    assert np.rad2deg(rendered[0].gaze.angle_to(fitted.subject.gaze)) < 15.0
    assert surface_errors(rendered[0].mesh, fitted.seen.mesh)["surface_mm"] < 2.0


def test_colours_come_close_and_residuals_agree_in_every_unit(fitted):
    left = fitted.residuals
    assert left["face_psnr_db"] > 20.0
    for kind in ("landmarks", "landmarks_less_expected_misses"):
        share = 100.0 * left[kind]["median_px"] / left["interocular_px"]
        assert left[kind]["median_percent"] == pytest.approx(share)
    assert left["landmarks_less_expected_misses"]["rms_px"] < left["landmarks"]["rms_px"]


def test_the_overlay_draws_the_fit_and_leaves_the_photograph(fitted):
    marked, plain, drawn = np.split(overlay(fitted), 3, axis=1)
    factor = plain.shape[0] // fitted.seen.image.shape[0]
    assert plain.shape[0] >= 480 and (marked != plain).any()
    outside = np.kron(fitted.seen.raster.parts == 0, np.ones((factor, factor))) > 0
    assert (drawn[outside] == plain[outside]).all() and (drawn != plain).any()


def test_the_subject_is_that_of_the_photograph(fitted, rendered, model, tmp_path):
    fitted.subject.save(tmp_path / "a.safetensors")
    again = type(fitted.subject).load(tmp_path / "a.safetensors")
    assert again.head_codes is not None and again.codes.sizes == model.code_sizes
    assert again.provenance["fine_tuned"] is False and again.provenance["head_model"] == model.name
    assert (again.camera.width, again.camera.height) == rendered[0].image.shape[1::-1]


def test_68_exact_landmarks_without_irises(model, rendered):
    item = rendered[0]
    (found,) = fit_photographs([Photograph("b.png", item.image, exact(item, model))], model)
    assert angle(item.camera, found.subject.camera) < 5.0 and found.residuals["landmarks"]["median_percent"] < 3.0


def test_two_pictures_share_identity_and_texture(model, rendered, landmarks, few_steps):
    photographs = [Photograph(f"{i}.png", rendered[i].image, landmarks[i]) for i in (0, 0)]
    first, second = fit_photographs(photographs, model)
    assert (first.subject.codes.identity == second.subject.codes.identity).all()
    assert (first.subject.codes.texture == second.subject.codes.texture).all()


def test_a_known_focal_length_is_held(model, rendered, landmarks):
    item = rendered[0]
    observed = Observed(landmarks[0], item.image.shape[1::-1], focal=item.camera.fx)
    found = fit_shape(model, [observed], table_for(model, dense=True)).pictures[0]
    assert found.camera.fx == pytest.approx(item.camera.fx, rel=0.02)


def test_irises_are_found_in_pixels_on_true_eyeballs(rendered, landmarks):
    errors = []
    for item, marks in zip(rendered, landmarks, strict=True):
        mesh = item.mesh
        found = find_eyes(item.image, marks, item.camera, mesh.eye_centres, mesh.eye_radius, mesh).irises
        if found is None:
            continue
        places = mesh.eye_centres + found.reach * mesh.eye_radius * item.gaze.vector()
        truth, z = item.camera.project(places)
        errors += (np.linalg.norm(found.pixels - truth, axis=1) * z / item.camera.fx * 100.0).tolist()
    errors = np.array(errors)[np.isfinite(errors)]
    assert len(errors) >= 4 and np.median(errors) < 0.4, "millimetres"


def test_closed_eyes_and_small_faces_are_said(model, rendered, landmarks, few_steps):
    item, points = rendered[0], landmarks[0].points.copy()
    from gazenerf.photographs.irises import LIDS_LEFT, LIDS_RIGHT

    for outline in (LIDS_LEFT, LIDS_RIGHT):
        points[list(outline), 1] = points[list(outline), 1].mean()
    closed = FaceLandmarks(points)
    assert max(openness(closed)) < 0.12 < min(openness(landmarks[0]))
    (found,) = fit_photographs([Photograph("shut.png", item.image, closed)], model)
    assert any("look closed" in line for line in found.warnings)


def test_faces_that_cannot_be_fitted_are_refused(model, rendered, landmarks, fitted):
    tiny = FaceLandmarks(landmarks[0].points / 20.0)
    with pytest.raises(UserError, match=r"t\.png are \d pixels apart"):
        fit_photographs([Photograph("t.png", rendered[0].image[:20, :20], tiny)], model)
    mixed = [
        Photograph("a", rendered[0].image, landmarks[0]),
        Photograph("b", rendered[0].image, exact(rendered[0], model)),
    ]
    with pytest.raises(UserError, match="same kind"):
        fit_photographs(mixed, model)


def test_a_profile_is_refused(model, rendered, landmarks, few_steps):
    from dataclasses import replace

    from gazenerf.geometry import Camera

    observed = Observed(landmarks[0], rendered[0].image.shape[1::-1])
    picture = fit_shape(model, [observed], table_for(model, dense=True)).pictures[0]
    refuse_profile("front.png", picture)
    with pytest.raises(UserError, match=r"side\.png is turned by 80 degrees"):
        refuse_profile("side.png", replace(picture, camera=Camera.orbit(np.deg2rad(80.0), 0.0)))


def test_alignment_takes_a_rigid_move_back():
    points = np.random.default_rng(0).normal(size=(20, 3))
    turn, _ = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    np.testing.assert_allclose(aligned(points, points @ turn.T + 3.0), points @ turn.T + 3.0, atol=1e-9)
