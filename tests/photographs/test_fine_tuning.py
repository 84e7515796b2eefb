"""A field learns a person's colours and nothing of its geometry; the teacher has the photograph's colours."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from gazenerf.checkpoints import load_field
from gazenerf.data.rasterizer import Rasterizer
from gazenerf.errors import UserError
from gazenerf.geometry import Camera, Gaze
from gazenerf.heads import Head
from gazenerf.image_metrics import psnr
from gazenerf.personal_weights import PersonalWeights
from gazenerf.photographs.appearance import Seen
from gazenerf.photographs.colour_learner import SHARES, ColourLearner, chances
from gazenerf.photographs.fine_tuning import Preview, learn
from gazenerf.photographs.held_views import draw_held, hold_view
from gazenerf.photographs.landmarks import FaceLandmarks
from gazenerf.photographs.lessons import Lesson, held_out_lessons, photograph_lesson, teacher_lessons
from gazenerf.photographs.teacher import make_teacher
from gazenerf.photographs.tuning import Tuning
from gazenerf.subjects import Codes, Subject
from gazenerf.training.texture_detail import without_detail
from tests.field_doubles import make_field, tiny_config

SIZE = 256


@pytest.fixture(scope="module")
def seen(model, rendered, landmarks) -> Seen:
    """A photograph of someone whose shape is known and whose texture is another's."""
    item = rendered[0]
    codes = wrong(item.codes)
    mesh = model.mesh(codes, item.gaze)
    with Rasterizer((384, 384), 1) as rasterizer:
        raster = rasterizer.render(mesh, np.zeros((len(mesh.vertices), 3)), item.camera)
    return Seen(item.image, landmarks[0], item.camera, mesh, raster)


def wrong(codes: Codes) -> Codes:
    return replace(codes, texture=-codes.texture)


@pytest.fixture(scope="module")
def teacher(model, rendered, seen):
    return make_teacher(model, wrong(rendered[0].codes), rendered[0].gaze, seen)


@pytest.fixture(scope="module")
def small():
    return load_field("small")


@pytest.fixture(scope="module")
def subject(rendered) -> Subject:
    codes = wrong(rendered[0].codes)
    return Subject("me", codes, codes, rendered[0].camera, rendered[0].gaze)


def test_the_teacher_has_the_photographs_colours_where_it_shows_skin(model, rendered, seen, teacher):
    item = rendered[0]
    with Rasterizer((384, 384), 2) as rasterizer:
        drawn = teacher.view(rasterizer, item.camera, item.gaze).image / 255.0
        plain = rasterizer.render_lit(seen.mesh, item.codes.illumination, item.camera).image / 255.0
        aside = replace_yaw(item.camera)
        true = rasterizer.render_lit(item.mesh, item.codes.illumination, aside).image / 255.0
        beside = teacher.view(rasterizer, aside, item.gaze)
        stranger = rasterizer.render_lit(seen.mesh, item.codes.illumination, aside).image / 255.0
    inside = seen.raster.parts == 1
    photograph = item.image / 255.0
    assert psnr(drawn, photograph, inside) > psnr(plain, photograph, inside) + 6.0
    both = beside.parts == 1
    assert psnr(beside.image / 255.0, true, both) > psnr(stranger, true, both) + 4.0


def replace_yaw(camera: Camera) -> Camera:
    x, _, z = camera.position
    return Camera.orbit(float(np.arctan2(x, z)) + 0.35, size=camera.width)


def test_a_photograph_in_a_square_keeps_its_places(seen, rendered):
    """A vertex lies in the square at the colour that it has in the photograph."""
    lesson = photograph_lesson(seen, rendered[0].codes, Gaze(), SIZE)
    points = seen.mesh.vertices[[np.abs(seen.mesh.vertices - seen.mesh.landmarks[str(i)]).sum(1).argmin()
                                 for i in (30, 36, 45, 48, 54, 8)]].astype(float)  # fmt: skip
    there, here = lesson.camera.project(points)[0], seen.camera.project(points)[0]
    scale = lesson.camera.fx / seen.camera.fx
    np.testing.assert_allclose(there - there[0], scale * (here - here[0]), atol=1e-6)
    place = [(lesson.image[:, int(v), int(u)].numpy(), seen.image[int(y), int(x)] / 255.0)
             for (u, v), (x, y) in zip(there, here, strict=True)]  # fmt: skip
    assert np.median([np.abs(a - b).max() for a, b in place]) < 0.08


@pytest.mark.parametrize("name", ["small", "portrait-sdf"])
def test_a_held_view_is_what_the_head_draws(name, subject):
    field = without_detail(load_field(name))  # as fields that are fine-tuned to a person are
    head, camera, gaze = Head(field, subject), Camera.orbit(0.3, size=128), Gaze(0.1, -0.2)
    view = hold_view(head, camera, gaze)
    with torch.no_grad():
        drawn = draw_held(field, view).permute(1, 2, 0).numpy()
        window = draw_held(field, view, (6, 5, 12, 16)).permute(1, 2, 0).numpy()
    seen = head.at(gaze).render(camera)
    inside = seen.geometry["head"].opacity > 0.99
    inside = np.kron(inside, np.ones((128 // inside.shape[0],) * 2)) > 0
    assert np.median(np.abs(drawn - seen.image)[inside]) < 0.004 and psnr(drawn, seen.image, inside) > 28.0
    k = field.config.upsampling
    border = 2 * k
    part = drawn[6 * k : 18 * k, 5 * k : 21 * k][border:-border, border:-border]
    np.testing.assert_allclose(window[border:-border, border:-border], part, atol=2e-3)


def test_a_person_is_learned_and_the_geometry_held(small, subject, teacher, seen):
    own = photograph_lesson(seen, subject.codes, subject.gaze, SIZE)
    learned = [own, *teacher_lessons(teacher, seen, subject.gaze, SIZE, small.config.upsampling, around=3, eyes=2)]
    held = list(held_out_lessons(teacher, seen, SIZE))
    assert [lesson.kind for lesson in learned] == ["own", *3 * ["around"], *2 * ["eyes"]]
    assert learned[-1].image.shape[1] < SIZE, "eyes alone"
    told, looks, tuning = [], [], Tuning(steps=60, check_every=30)

    def tell(stage: str, done: int, total: int, /) -> None:
        told.append(stage)

    learner = ColourLearner(small, learned, held, tuning, tell)
    start = learner.agreement()
    course = learn(learner, tuning, tell, preview=Preview(looks.append, 1e6))
    assert course.best is not None and course.done == 60 and course.best > start + 3.0
    assert [picture.shape for picture in looks[0][2]] == 2 * [(SIZE, SIZE, 3)]
    assert len(looks) == 1 and len(told) == 8 + 60
    better = replace(subject, personal=PersonalWeights(small.weights_hash, course.kept))
    assert all(".feature_" in name or ".plane." in name for name in course.kept)
    before, after = Head(small, subject).at(Gaze()), Head(small, better).at(Gaze())
    points = torch.rand(500, 3) * 2.0 - 1.0
    torch.testing.assert_close(after.density(points), before.density(points))
    lesson = held[0]
    target, mask = lesson.image.permute(1, 2, 0).numpy(), lesson.mask.numpy() > 0.99
    gain = psnr(after.head.at(lesson.gaze).render(lesson.camera).image, target, mask)
    assert gain > psnr(before.head.at(lesson.gaze).render(lesson.camera).image, target, mask) + 2.5


def test_learning_ends_where_held_out_views_do_not_gain(small, subject, teacher, seen):
    """The held-out picture is the field's own: nothing that is learned makes it better."""
    (lesson,) = teacher_lessons(teacher, seen, subject.gaze, SIZE, small.config.upsampling, around=1, eyes=0)
    own = Head(small, subject).at(lesson.gaze).render(lesson.camera).image
    same = Lesson(subject.codes, lesson.camera, lesson.gaze, torch.from_numpy(own).permute(2, 0, 1), lesson.mask)
    tuning = Tuning(steps=40, check_every=4, patience=2)
    learner = ColourLearner(small, [lesson], [same], tuning)
    start = learner.agreement()
    course = learn(learner, tuning)
    assert course.done == 8 and course.best == start
    assert all(not value.any() for name, value in course.kept.items() if ".plane." not in name)


def test_each_kind_of_lesson_has_its_share():
    found = chances(["own", "around", "around", "eyes"])
    np.testing.assert_allclose(found, [SHARES["own"], *2 * [0.5 * SHARES["around"]], SHARES["eyes"]])
    np.testing.assert_allclose(chances(["around", "eyes"]).sum(), 1.0)


def test_fields_of_another_kind_are_refused_in_one_line():
    field = make_field(tiny_config(merge="max"))
    with pytest.raises(UserError, match="only fields that this project trained"):
        ColourLearner(field, [], [], Tuning())


def test_the_eyes_of_the_teacher_take_the_photographs_iris(model, rendered, landmarks):
    """Blue irises in the photograph, brown ones fitted: the teacher's are blue wherever they look."""
    item = rendered[0]
    with Rasterizer((384, 384), 2) as rasterizer:
        raster = rasterizer.render_lit(item.mesh, item.codes.illumination, item.camera)
        image = item.image.copy()
        image[raster.parts > 1] = (40, 60, 220)
        teacher = make_teacher(
            model,
            item.codes,
            item.gaze,
            Seen(image, FaceLandmarks(landmarks[0].points), item.camera, item.mesh, raster),
        )
        turned = teacher.view(rasterizer, item.camera, Gaze(item.gaze.pitch, item.gaze.yaw + 0.3))
    red, _, blue = turned.image[turned.parts > 1].mean(axis=0)
    assert blue > red + 80
