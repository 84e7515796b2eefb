"""Photographs of one person are learned together: one field for all, and what one does not show the others tell."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gazenerf.data.rasterizer import Rasterizer
from gazenerf.geometry import Camera, Gaze
from gazenerf.head_model.interface import FACE
from gazenerf.head_model.shading import shade
from gazenerf.photographs import person_field
from gazenerf.photographs.appearance import Seen
from gazenerf.photographs.fit import FittedPhotograph
from gazenerf.photographs.landmarks import FaceLandmarks
from gazenerf.photographs.person_field import fit_field
from gazenerf.photographs.rendered_people import rendered_photographs
from gazenerf.photographs.teacher import Teacher, teacher_from
from gazenerf.photographs.told_colours import Told, told_by
from gazenerf.photographs.tuning import Tuning
from gazenerf.subjects import Subject
from tests.field_doubles import make_field, tiny_config
from tests.photographs.test_paper_learner import features, looked_at

SIDES = (40.0, -40.0)


@pytest.fixture(scope="module")
def known(model):
    """One person with a made-up texture, whose fit has another, seen from the left in warm and from the right in cold
    light: the true colours in each light, and the photographs' fits."""
    (truth,) = rendered_photographs(model, Rasterizer((64, 64), 1), 8, 0, 1)
    codes = replace(truth.codes, expression=0.0 * truth.codes.expression)
    fitted = replace(codes, texture=-codes.texture)
    mesh, plain = model.mesh(codes, Gaze()), model.mesh(fitted, Gaze())
    found = []
    for side, light in zip(SIDES, (codes.illumination, 0.7 * codes.illumination), strict=True):
        camera = Camera.orbit(np.deg2rad(side), size=192)
        with Rasterizer((192, 192), 2) as rasterizer:
            raster = rasterizer.render_lit(mesh, light, camera)
        points = np.stack([mesh.vertices[i] for i in model.landmark_vertices]).astype(float)
        marks = FaceLandmarks(camera.project(points)[0])
        seen = Seen(raster.image, marks, camera, plain, raster)
        lit = replace(fitted, illumination=light)
        subject = Subject("me", lit, lit, camera, Gaze(), {"photograph": f"{side:.0f}.png"})
        found.append((shade(mesh, light), FittedPhotograph(subject, seen, raster.image, points, points, {}, [])))
    return found


@pytest.fixture(scope="module")
def views(model, known):
    """What both methods begin with, made once, by teachers with the fitted colours."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(person_field, "make_teachers", lambda model, told: [plain_teacher(model, one) for one in told])
        return person_field._views([item for _, item in known], model, 32)


def plain_teacher(model, told: Told) -> Teacher:
    return Teacher(model, told.codes, 0.0 * told.wanted)


def told(model, fitted: FittedPhotograph):
    return told_by(model, fitted.subject.codes, fitted.subject.gaze, fitted.seen)


def test_a_teacher_has_from_the_other_photograph_what_its_own_does_not_show(model, known):
    own, other = (told(model, fitted) for _, fitted in known)
    skin = np.unique(own.mesh.part_faces(FACE))
    hidden = skin[(own.trust[skin] == 0.0) & (other.trust[skin] > 0.9)]
    assert len(hidden) > 200
    alone, together = teacher_from(model, own), teacher_from(model, own, [other])
    plain = shade(own.mesh, own.codes.illumination)
    error = [np.abs(plain + one.differences - known[0][0])[hidden].mean() for one in (alone, together)]
    assert error[1] < 0.6 * error[0], "in its own light, which the other photograph does not have"
    shown = skin[own.trust[skin] > 0.9]
    np.testing.assert_allclose(together.differences[shown], alone.differences[shown], atol=0.03)


def test_the_paper_learns_one_field_and_codes_for_each(model, known, views, monkeypatch):
    monkeypatch.setattr(person_field, "_views", lambda *given: views)
    monkeypatch.setattr(person_field, "paper_networks", lambda: (features, looked_at))
    monkeypatch.setattr(person_field, "INTEROCULAR", 20.0)
    slabs = tiny_config(expression=52, texture=36, merge="max", sampler="slabs", samples=6)
    first, second = fit_field(make_field(slabs), [item for _, item in known], model, Tuning("x", "paper", steps=3))
    assert first.measured["photographs"] == 2 and first.measured["steps"] == 4
    assert first.subject.personal is second.subject.personal is not None
    assert np.abs(first.subject.codes.illumination - second.subject.codes.illumination).max() > 0.01
    assert first.subject.provenance["photograph"] != second.subject.provenance["photograph"]


def test_the_teachers_of_all_photographs_are_learned_from(model, known, views, monkeypatch):
    """Which lessons are given; what is made of them is tested elsewhere."""

    class Stop(Exception):
        pass

    given = []
    monkeypatch.setattr(person_field, "_views", lambda *given: views)
    monkeypatch.setattr(person_field, "FURTHER", 1)

    def taken(field, lessons, held_out, tuning, progress):
        given.extend([lessons, held_out])
        raise Stop

    monkeypatch.setattr(person_field, "ColourLearner", taken)
    with pytest.raises(Stop):
        field = make_field(tiny_config(expression=52, texture=36))
        fit_field(field, [item for _, item in known], model, Tuning("x", around=2, eye_views=2))
    lessons, held_out = given
    lights = [item.subject.codes.illumination for _, item in known]
    whose = [next(i for i in (0, 1) if item.codes.illumination is lights[i]) for item in lessons]
    assert [item.kind for item in lessons[:2]] == ["own", "own"] and whose[:2] == [0, 1]
    assert whose[2:] == 4 * [0] + 2 * [1], "the first photograph's teacher from all sides, the other's from before"
    assert [item.codes.illumination is lights[1] for item in held_out] == [False, False, True, True]
