"""Lids lie over eyeballs and openings are open, whoever it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial import KDTree

from gazenerf.checkpoints import load_field
from gazenerf.data.rasterizer import Rasterizer
from gazenerf.data.surface_points import template_of
from gazenerf.errors import UserError
from gazenerf.field.lids import BORDER, OVER, PLACED_ANEW, UNDER, Lids, _border
from gazenerf.geometry import Camera, Gaze
from gazenerf.head_model import FACE, load_head_model
from gazenerf.head_model.model import EYE_RADIUS
from gazenerf.head_model.ray_scenes import ray_scene, tensor
from gazenerf.head_model.sampling import sample_person
from gazenerf.heads import Head
from gazenerf.heads.lids import lids
from gazenerf.image_metrics import psnr
from gazenerf.subjects import Subject, load_subject

CONTOURS = (range(42, 48), range(36, 42))
"""Standard landmarks around the opening of the subject's left and right eye."""


@pytest.fixture(scope="module")
def known() -> Lids:
    codes = load_subject("jana").codes
    return lids(codes, load_head_model().mesh(codes, Gaze()), 0.0)


def border(known: Lids, places: np.ndarray, eye: int) -> np.ndarray:
    local = torch.from_numpy(places.astype(np.float32)) - known.template_centres[eye]
    return _border(known.openings, local, torch.full((len(places),), eye)).numpy()


@pytest.mark.parametrize("eye", [0, 1], ids=["left", "right"])
def test_openings_end_where_the_head_model_has_its_landmarks(known: Lids, eye: int) -> None:
    template = template_of(load_head_model())
    contour = np.stack([template.landmarks[str(number)] for number in CONTOURS[eye]])
    assert np.abs(border(known, contour, eye)).max() < 0.015
    middle = contour.mean(axis=0, keepdims=True)
    above = middle + np.array([0.0, 0.08, 0.0])
    assert border(known, middle, eye)[0] > 0.03 and border(known, above, eye)[0] < -0.03


def test_a_lid_is_before_the_eyeball_and_an_opening_behind_it(known: Lids) -> None:
    eye, radius = 0, float(known.radius)
    angles = np.deg2rad(np.linspace(-75.0, 75.0, 61))
    outward = np.stack([np.zeros(61), np.sin(angles), np.cos(angles)], axis=-1)
    places = known.template_centres[eye] + torch.from_numpy(1.02 * radius * outward).float()
    points = places + known.centres[eye] - known.template_centres[eye]
    side = border(known, places.numpy(), eye)
    before, behind = (known.over(torch.full((1, 61), value), points[None], places[None])[0] for value in (0.05, -0.05))
    lid, opening = side < BORDER[0], side > BORDER[1]
    assert lid.sum() > 10 and opening.sum() > 10 and (~lid & ~opening).any()
    np.testing.assert_allclose(before[lid], 0.02 * radius - OVER, atol=1e-5)
    np.testing.assert_allclose(before[~lid], 0.05)
    np.testing.assert_allclose(behind[opening], 0.02 * radius + UNDER, atol=1e-5)
    np.testing.assert_allclose(behind[~opening], -0.05)


def test_what_is_far_from_eyes_stays_as_it_is(known: Lids) -> None:
    points = torch.tensor([[[0.0, -0.5, 0.9], [0.0, 0.0, 0.0]]])
    distance = torch.tensor([[0.3, -0.4]])
    assert known.over(distance, points, points) is distance
    with_an_eye = torch.cat([points, known.centres[:1, None]], dim=1)
    found = known.over(torch.tensor([[0.3, -0.4, -0.1]]), with_an_eye, with_an_eye)
    assert torch.equal(found[:, :2], distance)


def wrong_places(head: Head, gaze: Gaze) -> int:
    """How many of some thousand places on eyeballs the field's face covers where the head model's does not, or not
    where it does; 2 mm of the lids' edges are left out."""
    mesh = load_head_model().mesh(head.subject.codes, gaze)
    skin = ray_scene(mesh.vertices, mesh.part_faces(FACE))
    outward = np.random.default_rng(1).normal(size=(3000, 3))
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    outward = outward[outward[:, 2] > 0.3]
    bound, wrong = head.at(gaze), 0
    for centre in mesh.eye_centres:
        before = np.concatenate([centre + 1.04 * EYE_RADIUS * outward, outward], axis=-1)
        covered = skin.cast_rays(tensor(before))["t_hit"].numpy() < 0.1
        for cover in (True, False):
            inside, other = outward[covered == cover], outward[covered != cover]
            away = KDTree(other).query(inside)[0] * EYE_RADIUS if len(other) else np.ones(len(inside))
            points = torch.from_numpy((centre + EYE_RADIUS * inside[away > 0.02]).astype(np.float32))
            found = bound.field.signed_distance("face", points[None], bound.conditions["face"])[0]
            wrong += int(((found < 0.0) != cover).sum())
    return wrong


def without_lids(head: Head) -> Head:
    head.__dict__["lids"] = None
    return head


@pytest.mark.parametrize("seed", [13, 22])
def test_strangers_have_no_skin_on_their_irises_and_no_eyeballs_through_their_lids(seed: int) -> None:
    codes, gaze = sample_person(np.random.default_rng(seed), load_head_model()), Gaze.from_degrees(-15.0, 0.0)
    head, other = (Head(load_field("portrait-sdf"), Subject("stranger", codes, codes)) for _ in range(2))
    before = wrong_places(without_lids(other), gaze)
    assert before > 20, "as the network alone has it"
    assert wrong_places(head, gaze) <= 0.1 * before


def without_shut_lids(head: Head) -> Head:
    assert head.lids is not None
    head.__dict__["lids"] = head.lids._replace(shut=None)
    return head


def blinking(amount: float) -> Subject:
    jana, names = load_subject("jana"), load_head_model().expression_names
    expression = jana.codes.expression.copy()
    expression[[names.index(name) for name in ("eyeBlinkLeft", "eyeBlinkRight")]] = amount
    return replace(jana, codes=replace(jana.codes, expression=expression))


@pytest.mark.parametrize("shut", [0.5, 1.0])
def test_lids_that_an_expression_shuts_stay_shut(shut: float) -> None:
    head, other = (Head(load_field("portrait-sdf"), blinking(shut)) for _ in range(2))
    for pitch in (0.0, -15.0):
        gaze = Gaze.from_degrees(pitch, 10.0)
        assert wrong_places(head, gaze) <= wrong_places(without_lids(other), gaze) + 10


def test_skin_about_shut_eyes_is_placed_where_the_head_model_has_it() -> None:
    subject, template = blinking(1.0), template_of(load_head_model())
    mesh = load_head_model().mesh(subject.codes, Gaze())
    shut = lids(subject.codes, mesh, 0.0)
    assert shut.shut is not None and shut.shut.shares.tolist() == [1.0, 1.0]
    skin = np.unique(mesh.part_faces(FACE))
    away = np.linalg.norm(mesh.vertices[skin][:, None] - mesh.eye_centres, axis=-1).min(axis=1) / EYE_RADIUS
    ahead = mesh.vertices[skin][:, 2] > mesh.eye_centres[0][2] + 0.5 * EYE_RADIUS
    outer = (mesh.normals[skin] * (mesh.vertices[skin] - mesh.eye_centres.mean(axis=0))).sum(axis=1) > 0.0
    near, far = skin[(away < 1.3) & ahead & outer], skin[away > PLACED_ANEW[1]][::50]
    points, wrong = (torch.from_numpy(mesh.vertices[some].astype(np.float32))[None] for some in (near, far))
    found = shut.placed(torch.zeros_like(points), points)[0].numpy()
    open_eyed = without_shut_lids(Head(load_field("portrait-sdf"), subject))
    bound = open_eyed.at(Gaze())
    network = bound.field.streams["face"].places(points, bound.conditions["face"])[0].detach().numpy()
    off, before = (np.median(np.linalg.norm(some - template.vertices[near], axis=1)) for some in (found, network))
    assert off < 0.01 and off < 0.5 * before, (off, before)
    untouched = torch.zeros_like(wrong)
    assert shut.placed(untouched, wrong) is untouched
    half = replace(subject, codes=replace(subject.codes, expression=0.25 * subject.codes.expression))
    part = lids(half.codes, mesh, 0.0)
    assert part.shut is not None and 0.3 < float(part.shut.shares[0]) < 0.7
    partly = part.placed(torch.zeros_like(points), points)[0].numpy()
    np.testing.assert_allclose(partly, float(part.shut.shares[0]) * found, atol=1e-5)


def test_open_eyes_and_fields_without_features_on_the_template_are_placed_by_the_network() -> None:
    head = Head(load_field("portrait-sdf"), blinking(0.05))
    assert head.lids is not None and head.lids.shut is None
    assert Head(load_field("portrait"), blinking(1.0)).lids is None


@pytest.mark.parametrize(("amount", "nearer"), [(0.5, 1.0), (1.0, 1.0)])
def test_half_shut_and_shut_eyes_look_more_like_the_head_models(amount: float, nearer: float) -> None:
    subject, camera, gaze = blinking(amount), Camera.orbit(0.1, size=256), Gaze.from_degrees(0.0, 8.0)
    mesh = load_head_model().mesh(subject.codes, gaze)
    try:
        with Rasterizer((256, 256), 2) as rasterizer:
            truth = rasterizer.render_lit(mesh, subject.codes.illumination, camera).image / 255.0
    except UserError as error:
        pytest.skip(str(error))
    head, other = (Head(load_field("portrait-sdf"), subject) for _ in range(2))
    without_shut_lids(other)
    about = camera.project(mesh.eye_centres)[0].mean(axis=0).astype(int)
    rows, columns = slice(about[1] - 18, about[1] + 18), slice(about[0] - 55, about[0] + 55)
    after, before = (
        psnr(one.at(gaze).render(camera).image[rows, columns], truth[rows, columns]) for one in (head, other)
    )
    assert after > before + nearer, (before, after)
