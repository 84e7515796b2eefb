"""Lids lie over eyeballs and openings are open, whoever it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial import KDTree

from gazenerf.checkpoints import load_field
from gazenerf.data.surface_points import template_of
from gazenerf.field.lids import BORDER, OVER, UNDER, Lids, _border
from gazenerf.geometry import Gaze
from gazenerf.head_model import FACE, load_head_model
from gazenerf.head_model.model import EYE_RADIUS
from gazenerf.head_model.ray_scenes import ray_scene, tensor
from gazenerf.head_model.sampling import sample_person
from gazenerf.heads import Head
from gazenerf.heads.lids import lids
from gazenerf.subjects import Subject, load_subject

CONTOURS = (range(42, 48), range(36, 42))
"""Standard landmarks around the opening of the subject's left and right eye."""


@pytest.fixture(scope="module")
def known() -> Lids:
    return lids(load_head_model().mesh(load_subject("jana").codes, Gaze()), 0.0)


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


@pytest.mark.parametrize("shut", [0.5, 1.0])
def test_lids_that_an_expression_shuts_stay_shut(shut: float) -> None:
    jana, names = load_subject("jana"), load_head_model().expression_names
    expression = jana.codes.expression.copy()
    expression[[names.index(name) for name in ("eyeBlinkLeft", "eyeBlinkRight")]] = shut
    subject = replace(jana, codes=replace(jana.codes, expression=expression))
    head, other = (Head(load_field("portrait-sdf"), subject) for _ in range(2))
    for pitch in (0.0, -15.0):
        gaze = Gaze.from_degrees(pitch, 10.0)
        assert wrong_places(head, gaze) <= wrong_places(without_lids(other), gaze) + 10
