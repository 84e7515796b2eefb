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
from gazenerf.field.lids import BORDER, OVER, PLACED_RADII, UNDER, Lids, _by_direction
from gazenerf.geometry import Camera, Gaze
from gazenerf.head_model import FACE, load_head_model
from gazenerf.head_model.interface import HeadMesh
from gazenerf.head_model.lids import LID_LIMIT, LID_PITCH, LID_YAW
from gazenerf.head_model.model import EYE_RADIUS
from gazenerf.head_model.ray_scenes import ray_scene, tensor
from gazenerf.head_model.sampling import sample_person
from gazenerf.heads import Head
from gazenerf.heads.lids import KEYS, between, lids
from gazenerf.heads.person import Person
from gazenerf.image_metrics import psnr
from gazenerf.subjects import Subject, load_subject

CONTOURS = (range(42, 48), range(36, 42))
"""Standard landmarks around the opening of the subject's left and right eye."""


@pytest.fixture(scope="module")
def known() -> Lids:
    return lids(load_subject("jana").codes, Gaze(), 0.0)


def border(known: Lids, points: np.ndarray, eye: int) -> np.ndarray:
    local = torch.from_numpy(points.astype(np.float32)) - known.centres[eye]
    return _by_direction(known.openings, local, torch.full((len(points),), eye)).numpy()[:, 0]


@pytest.mark.parametrize("pitch", [-20.0, 0.0, 15.0])
@pytest.mark.parametrize("eye", [0, 1], ids=["left", "right"])
def test_openings_end_where_the_head_model_has_its_landmarks(eye: int, pitch: float) -> None:
    codes, gaze = load_subject("jana").codes, Gaze.from_degrees(pitch, 0.0)
    mesh, known = load_head_model().mesh(codes, gaze), lids(codes, gaze, 0.0)
    contour = np.stack([mesh.landmarks[str(number)] for number in CONTOURS[eye]])
    assert np.abs(border(known, contour, eye)).max() < 0.02
    middle = contour.mean(axis=0, keepdims=True)
    above = contour[:, 1].max() + 0.06 - middle[:, 1]
    assert border(known, middle, eye)[0] > 0.02
    assert border(known, middle + np.array([0.0, above[0], 0.0]), eye)[0] < -0.02


def test_a_lid_is_before_the_eyeball_and_an_opening_behind_it(known: Lids) -> None:
    eye, radius = 0, float(known.radius)
    angles = np.deg2rad(np.linspace(-75.0, 75.0, 61))
    outward = np.stack([np.zeros(61), np.sin(angles), np.cos(angles)], axis=-1)
    points = known.centres[eye] + torch.from_numpy(1.02 * radius * outward).float()
    side = border(known, points.numpy(), eye)
    before, behind = (known.over(torch.full((1, 61), value), points[None])[0] for value in (0.05, -0.05))
    lid, opening = side < BORDER[0], side > BORDER[1]
    assert lid.sum() > 10 and opening.sum() > 10 and (~lid & ~opening).any()
    np.testing.assert_allclose(before[lid], 0.02 * radius - OVER, atol=1e-5)
    np.testing.assert_allclose(before[~lid], 0.05)
    np.testing.assert_allclose(behind[opening], 0.02 * radius + UNDER, atol=1e-5)
    np.testing.assert_allclose(behind[~opening], -0.05)


def test_what_is_far_from_eyes_stays_as_it_is(known: Lids) -> None:
    points = torch.tensor([[[0.0, -0.5, 0.9], [0.0, 0.0, 0.0]]])
    distance = torch.tensor([[0.3, -0.4]])
    assert known.over(distance, points) is distance
    with_an_eye = torch.cat([points, known.centres[:1, None]], dim=1)
    found = known.over(torch.tensor([[0.3, -0.4, -0.1]]), with_an_eye)
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
    head.lids = lambda gaze: None
    return head


@pytest.mark.parametrize("seed", [13, 22])
def test_strangers_have_no_skin_on_their_irises_and_no_eyeballs_through_their_lids(seed: int) -> None:
    codes, gaze = sample_person(np.random.default_rng(seed), load_head_model()), Gaze.from_degrees(-15.0, 0.0)
    head, other = (Head(load_field("portrait-sdf"), Subject("stranger", codes, codes)) for _ in range(2))
    before = wrong_places(without_lids(other), gaze)
    assert before > 20, "as the network alone has it"
    assert wrong_places(head, gaze) <= 0.1 * before


def unplaced(head: Head) -> Head:
    """The head with lids whose skin has the places that the network gives."""
    found = head.lids

    def lids_at(gaze: Gaze) -> Lids | None:
        known = found(gaze)
        assert known is not None
        return known._replace(skins=torch.zeros_like(known.skins), shut=torch.zeros_like(known.shut))

    head.lids = lids_at
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


def skin_about_eyes(mesh: HeadMesh) -> np.ndarray:
    """Vertices of lids and of what is next to them, that are seen from before."""
    skin = np.unique(mesh.part_faces(FACE))
    nearest = np.linalg.norm(mesh.vertices[skin][:, None] - mesh.eye_centres, axis=-1)
    local = mesh.vertices[skin] - np.asarray(mesh.eye_centres)[nearest.argmin(axis=1)]
    away = nearest.min(axis=1)
    ahead = (local[:, 2] > 0.7 * away) & ((mesh.normals[skin] * local).sum(axis=1) > 0.5 * away)
    return skin[(away < 1.3 * EYE_RADIUS) & ahead]


@pytest.mark.parametrize(
    ("shut", "pitch"), [(1.0, 0.0), (0.5, 0.0), (0.0, -20.0)], ids=["shut", "half shut", "lowered"]
)
def test_skin_of_shut_and_lowered_lids_is_placed_where_the_head_model_has_it(shut: float, pitch: float) -> None:
    subject, template = blinking(shut), template_of(load_head_model())
    gaze = Gaze.from_degrees(pitch, 0.0)
    mesh = load_head_model().mesh(subject.codes, gaze)
    near = skin_about_eyes(mesh)
    assert len(near) > 1000
    points = torch.from_numpy(mesh.vertices[near].astype(np.float32))[None]
    heads = Head(load_field("portrait-sdf"), subject), unplaced(Head(load_field("portrait-sdf"), subject))
    off = []
    for head in heads:
        bound = head.at(gaze)
        found = bound.field.streams["face"].places(points, bound.conditions["face"])[0].detach().numpy()
        off.append(np.median(np.linalg.norm(found - template.vertices[near], axis=1)))
    assert off[0] < 0.006 and off[0] < 0.5 * off[1], off


def test_skin_far_from_eyes_and_of_open_eyes_is_placed_by_the_network(known: Lids) -> None:
    mesh = load_head_model().mesh(load_subject("jana").codes, Gaze())
    skin = np.unique(mesh.part_faces(FACE))
    away = np.linalg.norm(mesh.vertices[skin][:, None] - mesh.eye_centres, axis=-1).min(axis=1) / EYE_RADIUS
    near, far = (
        torch.from_numpy(mesh.vertices[some].astype(np.float32))[None]
        for some in (skin_about_eyes(mesh), skin[away > PLACED_RADII[1]][::50])
    )
    lowered = lids(load_subject("jana").codes, Gaze.from_degrees(-20.0, 0.0), 0.0)
    untouched = torch.zeros_like(far)
    assert lowered.placed(untouched, far) is untouched
    assert not known.placed(torch.zeros_like(near), near).any()
    assert lowered.placed(torch.zeros_like(near), near).any()


def test_half_as_shut_is_placed_half_and_lids_are_thicker_the_more_they_are_shut() -> None:
    half, whole = (lids(blinking(amount).codes, Gaze(), 0.0) for amount in (0.25, 1.0))
    assert torch.allclose(half.shut, torch.tensor([0.5, 0.5])) and whole.shut.tolist() == [1.0, 1.0]
    assert torch.equal(half.skins[:, :, 4] > 0.0, half.skins[:, :, 4] == 0.5)
    assert whole.skins[:, :, 4].max() == 1.0


@pytest.mark.parametrize("gaze", [(-17.0, 30.0), (-6.0, 11.0), (0.0, -12.0), (17.0, -12.0), (28.0, 0.0)])
def test_lids_between_gazes_are_nearly_those_of_the_gaze(gaze: tuple[float, float]) -> None:
    codes, at = load_subject("gus").codes, Gaze.from_degrees(*gaze)
    found, exact = Person(codes, 0.0).lids(at), lids(codes, at, 0.0)
    assert found is not None
    off = (found.openings - exact.openings).abs()[exact.openings.abs() < 0.03]
    assert off.median() < 0.001 and off.quantile(0.95) < 0.005
    told = (found.skins[:, :, 4] > 0.0) & (exact.skins[:, :, 4] > 0.0)
    moved = (found.skins - exact.skins)[:, :, :3].norm(dim=2)[told]
    assert told.any() == (at.pitch < 0.0)
    if told.any():
        assert moved.median() < 0.002


def test_gazes_between_which_lids_are_found_surround_the_gaze() -> None:
    for pitch, yaw in [(0.0, 0.0), (-5.0, 3.0), (20.0, -40.0), (60.0, -70.0), (-33.0, 1.0)]:
        keys, weights = between(Gaze.from_degrees(pitch, yaw))
        labels = np.array([key.label for key in keys])
        assert sum(weights) == pytest.approx(1.0) and min(weights) > 0.0 and len(keys) <= 4
        limits = np.array([LID_LIMIT * LID_PITCH, LID_LIMIT * LID_YAW])
        wanted = np.clip(np.deg2rad([pitch, yaw]), -limits, limits)
        np.testing.assert_allclose(np.array(weights) @ labels, wanted, atol=1e-6)
        assert (np.ptp(labels, axis=0) <= limits / KEYS + 1e-6).all()


def test_fields_without_features_on_the_template_know_no_lids() -> None:
    assert Head(load_field("portrait"), blinking(1.0)).lids(Gaze()) is None


@pytest.mark.parametrize(("pitch", "nearer"), [(-20.0, 1.0), (-28.0, 1.0)])
def test_lowered_lids_look_more_like_the_head_models(pitch: float, nearer: float) -> None:
    look_alike(load_subject("gus"), Gaze.from_degrees(pitch, 8.0), nearer, size=512)


@pytest.mark.parametrize(("amount", "nearer"), [(0.5, 1.0), (1.0, 1.0)])
def test_half_shut_and_shut_eyes_look_more_like_the_head_models(amount: float, nearer: float) -> None:
    look_alike(blinking(amount), Gaze.from_degrees(0.0, 8.0), nearer)


def look_alike(subject: Subject, gaze: Gaze, nearer: float, size: int = 256) -> None:
    """The eyes are more like the head model's by some decibels than with places of the network."""
    camera, mesh = Camera.orbit(0.1, size=size), load_head_model().mesh(subject.codes, gaze)
    try:
        with Rasterizer((size, size), 2) as rasterizer:
            truth = rasterizer.render_lit(mesh, subject.codes.illumination, camera).image / 255.0
    except UserError as error:
        pytest.skip(str(error))
    heads = Head(load_field("portrait-sdf"), subject), unplaced(Head(load_field("portrait-sdf"), subject))
    about = camera.project(mesh.eye_centres)[0].mean(axis=0).astype(int)
    rows, columns = (
        slice(at - reach * size // 256, at + reach * size // 256)
        for at, reach in zip(about[::-1], (18, 55), strict=True)
    )
    after, before = (psnr(head.at(gaze).render(camera).image[rows, columns], truth[rows, columns]) for head in heads)
    assert after > before + nearer, (before, after)
