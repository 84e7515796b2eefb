"""Fibres and highlights lie on the eyeballs as the head model has them, and only where they are seen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gazenerf.checkpoints import load_field
from gazenerf.field.config import FieldConfig
from gazenerf.field.detail import DARK
from gazenerf.geometry import Camera, Gaze
from gazenerf.head_model import load_head_model
from gazenerf.head_model.eyes import IRIS_ANGLE, RINGS_END, build_eye_mesh
from gazenerf.head_model.interface import EYE_LEFT, EYE_RIGHT
from gazenerf.head_model.ray_scenes import ray_scene, tensor
from gazenerf.head_model.shading import linear_to_srgb, shade, srgb_to_linear
from gazenerf.heads import Head
from gazenerf.heads.baked import BakedHead, bake, draw_together
from gazenerf.heads.batches import draw_guided
from gazenerf.heads.eye_detail import EyeDetail, eye_detail
from gazenerf.heads.highlights import without_highlights
from gazenerf.subjects import Subject, load_subject
from gazenerf.training.texture_detail import with_eye_detail, without_detail

SIZE, GAZE = 256, Gaze(0.1, -0.2)


@pytest.fixture(scope="module")
def subject() -> Subject:
    return load_subject("jana")


@pytest.fixture(scope="module")
def detail(subject: Subject) -> EyeDetail:
    return eye_detail(subject.codes)


@pytest.fixture(scope="module")
def heads(subject: Subject) -> tuple[Head, Head]:
    """A head without and with detail of its eyes."""
    bare = without_detail(load_field("portrait-sdf"))
    return Head(bare, subject), without_mouth_detail(Head(with_eye_detail(bare), subject))


def without_mouth_detail(head: Head) -> Head:
    """The head without detail of its mouth."""
    head.__dict__["mouth_detail"] = None
    return head


def pupils(head: Head, gaze: Gaze, camera: Camera) -> np.ndarray:
    mesh = load_head_model().mesh(head.subject.codes, gaze)
    return camera.project(np.stack([mesh.landmarks["iris_left"], mesh.landmarks["iris_right"]]).astype(np.float64))[0]


def changed(heads: tuple[Head, Head], gaze: Gaze, camera: Camera) -> np.ndarray:
    """(H, W) how much detail changes a picture."""
    before, after = (head.at(gaze).render(camera).image for head in heads)
    return np.abs(after - before).max(axis=-1)


@pytest.mark.parametrize("eye", [0, 1], ids=["left", "right"])
def test_it_is_what_the_head_model_shows_at_its_vertices(subject: Subject, detail: EyeDetail, eye: int) -> None:
    mesh, camera = load_head_model().mesh(subject.codes, GAZE), Camera.orbit(0.2, 0.1, size=SIZE)
    vertices = np.unique(mesh.part_faces((EYE_LEFT, EYE_RIGHT)[eye]))
    points = mesh.vertices[vertices].astype(np.float64)
    rays = points - camera.position
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    fibres, shine = detail.shown(eye, GAZE.rotation(), points, rays)
    angles = build_eye_mesh().ring_angles
    rings = len(angles)
    dark = np.log(linear_to_srgb(mesh.albedo[vertices][1:-1]).mean(axis=1) + DARK).reshape(rings, -1)
    iris = angles < RINGS_END
    expected = dark - dark.mean(axis=1, keepdims=True)
    np.testing.assert_allclose(fibres[1:-1].reshape(rings, -1)[iris], expected[iris], atol=2e-3)
    lit, mirrored = (
        srgb_to_linear(shade(mesh, subject.codes.illumination, position)[vertices])
        for position in (None, camera.position)
    )
    below = mirrored.max(axis=1) < 1.0
    np.testing.assert_allclose((mirrored - lit)[below].mean(axis=1), shine[below], atol=2e-3)
    assert shine.max() > 0.5 and np.abs(fibres).max() > 0.1


def test_rays_meet_the_bulging_surface_where_they_meet_the_mesh(subject: Subject, detail: EyeDetail) -> None:
    mesh, camera = load_head_model().mesh(subject.codes, GAZE), Camera.orbit(0.3, 0.1, size=SIZE)
    reach = 0.9 * detail.radius * camera.fx / np.linalg.norm(camera.position)
    (middle,), _ = camera.project(detail.centres[:1])
    at = middle + reach * np.random.default_rng(0).uniform(-0.7, 0.7, (200, 2))
    origins, rays = camera.rays(at)
    scene = ray_scene(mesh.vertices, mesh.part_faces(EYE_LEFT))
    found = scene.cast_rays(tensor(np.concatenate([origins, rays], axis=1).astype(np.float32)))["t_hit"].numpy()
    length, met = detail.surface(0, GAZE.rotation(), origins, rays)
    assert met.all() and np.isfinite(found).all()
    np.testing.assert_allclose(length, found, atol=5e-4)  # 0.05 mm


def test_a_picture_changes_at_the_irises_and_by_the_highlights(heads: tuple[Head, Head]) -> None:
    camera = Camera.orbit(0.0, size=SIZE)
    for gaze in (Gaze(), GAZE):
        change = changed(heads, gaze, camera)
        rows, columns = np.nonzero(change > 0.01)
        assert len(rows) > 40 and change.max() > 0.15
        away = np.linalg.norm(
            np.stack([columns, rows], axis=-1)[:, None] + 0.5 - pupils(heads[0], gaze, camera), axis=2
        )
        reach = np.sin(IRIS_ANGLE) * load_head_model().mesh(heads[0].subject.codes, gaze).eye_radius
        assert away.min(axis=1).max() < 2.0 * reach * camera.fx / np.linalg.norm(camera.position)


def test_nothing_is_drawn_on_what_hides_an_eye(heads: tuple[Head, Head], subject: Subject) -> None:
    assert changed(heads, Gaze(), Camera.orbit(np.pi, size=SIZE)).max() < 1e-6
    aside = changed(heads, Gaze(), Camera.orbit(np.pi / 2, size=SIZE))
    assert (aside > 0.01).sum() < 60  # one eye, seen from the side, and not the other through the nose
    expression = subject.codes.expression.copy()
    names = load_head_model().expression_names
    for name in ("eyeBlinkLeft", "eyeBlinkRight"):
        expression[names.index(name)] = 1.0
    shut = replace(subject, codes=replace(subject.codes, expression=expression))
    closed = Head(heads[0].field, shut), without_mouth_detail(Head(heads[1].field, shut))
    camera = Camera.orbit(0.0, size=SIZE)
    assert np.square(changed(closed, Gaze(), camera)).sum() < 0.05 * np.square(changed(heads, Gaze(), camera)).sum()


def test_parts_and_batches_show_it_alike(heads: tuple[Head, Head]) -> None:
    cameras = [Camera.orbit(yaw, size=SIZE) for yaw in (0.0, 0.3)]
    bound = heads[1].at(GAZE)
    parts, bare = (head.at(GAZE).render(cameras[0], ("face", "eyes", "head")) for head in heads)
    np.testing.assert_array_equal(parts.images["face"], bare.images["face"])
    more = np.abs(parts.images["eyes"] - bare.images["eyes"]).max(axis=-1) > 0.02
    seen = np.abs(parts.images["head"] - bare.images["head"]).max(axis=-1) > 0.02
    assert more.sum() >= seen.sum() > 20
    for one, camera in zip(draw_guided([bound, bound], cameras), cameras, strict=True):
        np.testing.assert_allclose(one.image, bound.render(camera).image, atol=2e-3)
    baked = draw_together([bake(heads[1], GAZE).at(GAZE)] * 2, cameras)
    without = draw_together([bake(heads[0], GAZE).at(GAZE)] * 2, cameras)
    for one, other in zip(baked, without, strict=True):
        assert (np.abs(one.image - other.image).max(axis=-1) > 0.02).sum() > 20


def test_textures_are_made_of_eyes_that_mirror_nothing(heads: tuple[Head, Head]) -> None:
    dull, camera = heads[1].without_highlights(), Camera.orbit(0.0, size=SIZE)
    assert dull is not heads[1] and dull.without_highlights() is dull and heads[0].without_highlights() is heads[0]
    bare, fibres, both = (head.at(Gaze()).render(camera).image for head in (heads[0], dull, heads[1]))
    assert np.abs(fibres - bare).max() > 0.02
    assert (both - fibres).min() > -1e-6 and (both - fibres).max() > 0.15
    baked = without_highlights(bake(heads[1], Gaze()))
    assert isinstance(baked, BakedHead) and baked.head.eye_detail == dull.eye_detail
    assert heads[1].eye_detail is not None and heads[1].eye_detail.mirrors  # it does so still
    np.testing.assert_array_equal(dull.frames.render([(dull.at(Gaze()), camera)])[0].images["head"], fibres)


def test_densities_have_none() -> None:
    with pytest.raises(ValueError, match="detail of the eyes needs distances"):
        FieldConfig(eye_detail=True)
