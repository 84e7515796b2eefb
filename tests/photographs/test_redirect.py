"""Redirected renders agree with true renders, keep what gaze does not move, and look where they are told to."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.redirect import GAZES, eye_region, measured, rendered_people, true_subject
from gazenerf.errors import UserError
from gazenerf.geometry import Gaze
from gazenerf.image_metrics import psnr
from gazenerf.photographs.redirect import REACH, Redirector


@pytest.fixture(scope="module")
def person(model):
    return rendered_people(model, 1, 31, 384)[0]


@pytest.fixture(scope="module")
def redirector(model, person) -> Redirector:
    return Redirector(person[0].image, true_subject(person[0]), model)


def test_results_agree_with_true_renders_and_look_where_they_are_told_to(model, person):
    rows = measured(model, person[0], true_subject(person[0]), person[1])
    assert len(rows) == len(GAZES)
    for row in rows:
        assert row["eyes_db"] > row["unchanged_db"] + 6.0 and row["eyes_db"] > 25.0
        assert row["read_degrees"] < 3.0
        assert row["same_gaze_db"] >= 38.0 and row["outside"] == 0


def test_the_gaze_of_the_photograph_and_one_near_it_change_next_to_nothing(person, redirector):
    image, gaze = person[0].image, redirector.subject.gaze
    np.testing.assert_array_equal(redirector.draw(gaze).pixels, image)
    near = redirector.draw(Gaze(gaze.pitch, gaze.yaw + np.deg2rad(0.3))).pixels
    assert psnr(near / 255.0, image / 255.0) > 38.0


def test_only_the_surroundings_of_the_eyes_change(person, redirector):
    made, (rendered, _) = redirector.draw(Gaze.from_degrees(-20.0, 30.0)), person
    centres = rendered.camera.project(rendered.mesh.eye_centres)[0]
    away = np.abs(rendered.camera.pixel_centres()[:, :, None] - centres).max(axis=-1).min(axis=-1)
    np.testing.assert_array_equal(made.pixels[~made.changed], rendered.image[~made.changed])
    assert made.changed.sum() > 300 and not made.changed[away > REACH * redirector.unit + 2.0].any()
    region = eye_region((rendered.mesh,), rendered.camera)
    assert made.changed[region].mean() > 5.0 * made.changed[~region].mean()


def test_towards_the_camera_each_eye_looks_at_it(redirector):
    for gaze, window in zip(redirector.towards_camera(), redirector._windows, strict=True):
        way = redirector.camera.position - window.layers.eyeball.centre
        np.testing.assert_allclose(gaze.vector(), way / np.linalg.norm(way), atol=1e-9)


def test_grain_is_put_on_what_was_not_seen(model, person):
    """The white that the iris uncovers is as grainy as the photograph."""
    rendered, _ = person
    noise = np.random.default_rng(0).normal(0.0, 6.0, rendered.image.shape[:2])[..., None]
    image = np.clip(rendered.image + noise, 0, 255).astype(np.uint8)
    made = Redirector(image, true_subject(rendered), model)
    assert made._grain == pytest.approx(6.0, rel=0.25)
    calm = Redirector(image, true_subject(rendered), model)
    calm._grain = 0.0
    gaze = Gaze.from_degrees(0.0, 25.0)
    added = made.draw(gaze).pixels.astype(float) - calm.draw(gaze).pixels
    assert 3.0 < added[np.abs(added) > 0].std() < 8.0


def test_what_cannot_be_redirected_is_refused(model, person):
    rendered, _ = person
    subject = true_subject(rendered)

    def refused(image=rendered.image, **changes) -> str:
        with pytest.raises(UserError) as error:
            Redirector(image, replace(subject, **changes), model)
        return str(error.value)

    dark = rendered.image.copy()
    left, right = rendered.camera.project(rendered.mesh.eye_centres)[0]
    top, side = int(min(left[1], right[1])) - 25, abs(int(left[0] - right[0]))
    dark[top : top + 50, int(min(left[0], right[0])) - side // 2 : int(max(left[0], right[0])) + side // 2] = 12
    assert "neither eye shows an iris" in refused(dark)
    flat = [[[0.0, 0.0], [30.0, 1.0], [60.0, 0.0], [30.0, -1.0]]] * 2
    assert "closed" in refused(provenance={"eye_outlines": flat})
    assert "damaged" in refused(provenance={"eye_outlines": [["a"]]})
    assert "no camera" in refused(camera=None)
    assert "was fitted to a picture of 384x384 pixels, this one is 384x192" in refused(rendered.image[::2])
    with pytest.raises(UserError, match="cannot be drawn at pitch 0, yaw 60"):
        Redirector(rendered.image, subject, model).draw(Gaze.from_degrees(0.0, 60.0))
