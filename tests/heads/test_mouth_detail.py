"""Teeth, gums and tongue are drawn as the head model has them, and only where an open mouth shows them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gazenerf.checkpoints import load_field
from gazenerf.geometry import Camera, Gaze
from gazenerf.head_model import MOUTH, load_head_model
from gazenerf.head_model.interface import EYE_LEFT, EYE_RIGHT, FACE, HAIR, HeadMesh
from gazenerf.head_model.ray_scenes import ray_scene, rays_of
from gazenerf.head_model.shading import shade
from gazenerf.heads import Head, mouth_detail
from gazenerf.heads.baked import bake, draw_together
from gazenerf.image_metrics import psnr
from gazenerf.subjects import Subject, load_subject
from gazenerf.training.texture_detail import without_detail

CAMERA = Camera.orbit(0.3, size=256)


@pytest.fixture(scope="module")
def subject() -> Subject:
    noa = load_subject("noa")
    expression = noa.codes.expression.copy()
    expression[load_head_model().expression_names.index("jawOpen")] = 0.5
    return replace(noa, codes=replace(noa.codes, expression=expression))


@pytest.fixture(scope="module")
def mesh(subject: Subject) -> HeadMesh:
    return load_head_model().mesh(subject.codes, Gaze())


@pytest.fixture(scope="module")
def detail(subject: Subject, mesh: HeadMesh) -> mouth_detail.MouthDetail:
    return mouth_detail.MouthDetail(mouth_detail.mouth_scene(mesh), shade(mesh, subject.codes.illumination))


@pytest.fixture(scope="module")
def heads(subject: Subject) -> tuple[Head, Head]:
    """A head without and with what its mouth shows."""
    found = Head(load_field("portrait-sdf"), subject), Head(load_field("portrait-sdf"), subject)
    found[0].__dict__["mouth_detail"] = None
    return found


def seen(mesh: HeadMesh, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """(H, W) whether the mouth's inside is what a pixel's middle shows, and (H, W) which triangle of it."""
    parts = (mesh.part_faces(part) for part in (MOUTH, FACE, EYE_LEFT, EYE_RIGHT))
    found = ray_scene(mesh.vertices, *parts).cast_rays(rays_of(camera))
    return found["geometry_ids"].numpy() == 0, found["primitive_ids"].numpy()


def test_it_has_the_colours_of_the_head_models_triangles(
    subject: Subject, mesh: HeadMesh, detail: mouth_detail.MouthDetail
) -> None:
    inside, triangles = seen(mesh, CAMERA)
    share, colour = detail.seen(CAMERA)
    assert inside.sum() > 150 and (share[inside] > 0.3).all() and (share > 0.0).sum() < 1.6 * inside.sum()
    corners = shade(mesh, subject.codes.illumination)[mesh.part_faces(MOUTH)[triangles[inside]]]
    whole = share[inside] == 1.0
    assert np.abs(colour[inside] - corners.mean(axis=1))[whole].mean() < 0.03
    between = (colour[inside] > corners.min(axis=1) - 0.1) & (colour[inside] < corners.max(axis=1) + 0.1)
    assert between[whole].mean() > 0.95


@pytest.mark.parametrize(("yaw", "pitch"), [(0.0, 0.5), (0.4, -0.7), (1.0, 0.2), (-1.3, 0.0), (0.3, 1.2), (1.5, -0.4)])
def test_what_hides_a_mouth_is_all_there(
    mesh: HeadMesh, detail: mouth_detail.MouthDetail, yaw: float, pitch: float
) -> None:
    camera = Camera.orbit(yaw, pitch, size=128)
    whole = ray_scene(mesh.vertices, mesh.part_faces(MOUTH), mesh.part_faces(FACE, HAIR))
    everything = replace(detail, shape=detail.shape._replace(scene=whole))
    for one, other in zip(detail.seen(camera), everything.seen(camera), strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_few_rows_at_a_time_are_the_same(detail: mouth_detail.MouthDetail, monkeypatch: pytest.MonkeyPatch) -> None:
    camera = CAMERA.cropped(80, 140, 90, 61)
    at_once = detail.seen(camera)
    monkeypatch.setattr(mouth_detail, "MOST_RAYS", 9 * 90 * 7)
    for one, other in zip(at_once, detail.seen(camera), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-6)


def test_pictures_come_nearer_to_the_head_model_and_change_between_the_lips_alone(
    subject: Subject, mesh: HeadMesh, heads: tuple[Head, Head]
) -> None:
    inside, triangles = seen(mesh, CAMERA)
    truth = shade(mesh, subject.codes.illumination)[mesh.part_faces(MOUTH)[triangles[inside]]].mean(axis=1)
    before, after = (head.at(Gaze()).render(CAMERA).image for head in heads)
    assert psnr(after[inside][None], truth[None]) > psnr(before[inside][None], truth[None]) + 6.0
    changed = np.abs(after - before).max(axis=-1) > 1e-6
    assert not changed[np.lib.stride_tricks.sliding_window_view(np.pad(inside, 1), (3, 3)).max((2, 3)) == 0].any()


def test_faces_alone_baked_pictures_and_pictures_drawn_together_have_it_and_eyes_do_not(
    heads: tuple[Head, Head],
) -> None:
    before, after = (head.at(Gaze()).render(CAMERA, ("face", "eyes")).images for head in heads)
    assert not np.array_equal(before["face"], after["face"]) and np.array_equal(before["eyes"], after["eyes"])
    baked = bake(heads[1], Gaze())
    cameras = [CAMERA, Camera.orbit(-0.2, size=256)]
    inside = heads[1].mouth_detail.seen(CAMERA)[0] == 1.0
    together = draw_together([baked.at(Gaze())] * 2, cameras)
    for one, camera in zip(together, cameras, strict=True):
        np.testing.assert_allclose(one.image, baked.at(Gaze()).render(camera).image, atol=2e-3)
    alone = heads[1].at(Gaze()).render(CAMERA).image
    np.testing.assert_allclose(together[0].image[inside], alone[inside], atol=1e-3)


def test_nothing_is_drawn_where_no_mouth_is_seen(heads: tuple[Head, Head]) -> None:
    behind = Camera.orbit(np.pi, size=128)
    before, after = (head.at(Gaze()).render(behind).image for head in heads)
    assert np.array_equal(before, after)
    looking_away = Camera.look_at(np.array([0.0, 0.0, 3.0]), np.array([0.0, 0.0, 9.0]), size=64)
    assert mouth_detail._window(heads[1].mouth_detail.shape.lips, looking_away) is None


def test_fields_that_do_not_ask_have_none(subject: Subject) -> None:
    assert Head(without_detail(load_field("portrait-sdf")), subject).mouth_detail is None
    assert Head(load_field("portrait"), subject).mouth_detail is None


def test_a_small_mouth_is_drawn_in_half_precision(heads: tuple[Head, Head]) -> None:
    head = Head(heads[1].field, heads[1].subject, precision="bfloat16")
    assert np.isfinite(head.at(Gaze()).render(Camera.orbit(0.0, size=64)).image).all()
