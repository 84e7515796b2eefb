"""Detail of a photograph lies on the field's surface and says nothing where the photograph does not."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from gazenerf.checkpoints import load_field
from gazenerf.data.rasterizer import Rasterizer
from gazenerf.field.detail import EXTENT
from gazenerf.geometry import Gaze
from gazenerf.heads import Head
from gazenerf.image_metrics import psnr
from gazenerf.personal_weights import PersonalWeights
from gazenerf.photographs.appearance import Seen, eye_openings, seen_vertices
from gazenerf.photographs.lessons import moved_to_square, photograph_lesson, teacher_cameras
from gazenerf.photographs.skin_detail import TEXEL, _told, photograph_detail
from gazenerf.subjects import Subject

SIZE = 256


@pytest.fixture(scope="module")
def person(rendered, landmarks) -> tuple[Subject, Seen]:
    """A photograph whose head is known: the field's own picture, with freckles painted on the skin."""
    item = rendered[0]
    with Rasterizer((384, 384), 1) as rasterizer:
        raster = rasterizer.render(item.mesh, np.zeros((len(item.mesh.vertices), 3)), item.camera)
    subject = Subject("me", item.codes, item.codes, item.camera, item.gaze)
    drawn = Head(load_field("small"), subject).at(item.gaze).render(item.camera).image
    rows, columns = np.mgrid[0:384, 0:384]
    freckles = 0.12 * (np.sin(0.5 * rows) * np.sin(0.5 * columns))[..., None]
    image = np.round(255.0 * np.clip(drawn - freckles, 0.0, 1.0)).astype(np.uint8)
    return subject, Seen(image, landmarks[0], item.camera, item.mesh, raster)


@pytest.fixture(scope="module")
def with_detail(person: tuple[Subject, Seen]) -> tuple[Head, Head, np.ndarray]:
    subject, seen = person
    field = load_field("small")
    head = Head(field, subject, device="cpu", precision="float32")
    values = photograph_detail(head, seen, subject.gaze)
    personal = PersonalWeights(field.weights_hash, {"detail.values": values})
    return head, Head(field, replace(subject, personal=personal)), values


def test_the_photograph_is_drawn_again(person, with_detail) -> None:
    (subject, seen), (before, after, values) = person, with_detail
    assert values.dtype == np.float16 and values.shape == (3, 2 * EXTENT[1] / TEXEL, 2 * EXTENT[0] / TEXEL)
    lesson = photograph_lesson(seen, subject.codes, subject.gaze, SIZE)
    wanted = lesson.image.permute(1, 2, 0).numpy()
    openings = moved_to_square(seen, eye_openings(seen.landmarks, (384, 384)).astype(np.float32), SIZE, 1) > 0.1
    away = cv2.dilate(openings.astype(np.uint8), np.ones((15, 15), np.uint8)) == 0
    inside = cv2.erode((lesson.mask.numpy() > 0.99).astype(np.uint8), np.ones((31, 31), np.uint8)) > 0
    first, second = (head.at(subject.gaze).render(lesson.camera).image for head in (before, after))
    assert psnr(second, wanted, inside & away) > psnr(first, wanted, inside & away) + 6.0
    np.testing.assert_allclose(second[openings], first[openings], atol=0.02)


def test_lids_are_told_up_to_their_edges_where_features_move_with_them(person) -> None:
    subject, seen = person
    lesson = photograph_lesson(seen, subject.codes, subject.gaze, SIZE)
    still, moving = (_told(seen, lesson, lids_move) for lids_move in (False, True))
    openings = moved_to_square(seen, eye_openings(seen.landmarks, (384, 384)).astype(np.float32), SIZE, 1) > 0.5
    kernel = np.ones((13, 13), np.uint8)
    beside = (cv2.dilate(openings.astype(np.uint8), kernel) > 0) & ~openings
    inside = cv2.erode(openings.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    assert np.median(moving[beside]) > np.median(still[beside]) + 0.5
    assert inside.any() and moving[inside].max() < 0.2
    away = cv2.dilate(openings.astype(np.uint8), np.ones((61, 61), np.uint8)) == 0
    assert (np.abs(moving - still)[away] > 0.01).mean() < 0.01


def test_freckles_are_seen_where_they_lie_from_another_side(person, with_detail) -> None:
    """The head model's surface tells where a pixel of the photograph is to be seen from 20 degrees beside it."""
    (subject, seen), (before, after, _) = person, with_detail
    [camera] = teacher_cameras(seen.camera, 384, ((20, 0),))
    first, second = (head.at(subject.gaze).render(camera).image for head in (before, after))
    vertices = seen.mesh.vertices.astype(np.float64)
    _, cosine, visible = seen_vertices(seen)
    cheek = visible & (cosine > 0.8) & (np.linalg.norm(vertices - seen.mesh.landmarks["30"], axis=1) < 0.45)
    there, here = camera.project(vertices[cheek])[0], seen.camera.project(vertices[cheek])[0]

    def at(picture: np.ndarray, pixels: np.ndarray) -> np.ndarray:
        x, y = (pixels - 0.5).astype(np.float32).T
        return cv2.remap(picture.mean(-1).astype(np.float32), x, y, cv2.INTER_LINEAR).ravel()

    freckles = np.sin(0.5 * (here[:, 1] - 0.5)) * np.sin(0.5 * (here[:, 0] - 0.5))
    added = at(second - first, there)
    assert np.corrcoef(-freckles, added)[0, 1] > 0.7


def test_a_head_that_is_not_in_the_picture_has_no_detail(person, with_detail) -> None:
    (_, seen), (before, _, _) = person, with_detail
    camera = replace(seen.camera, cx=seen.camera.cx + 4000.0)
    nothing = photograph_detail(before, replace(seen, camera=camera), Gaze())
    assert not nothing.any()
