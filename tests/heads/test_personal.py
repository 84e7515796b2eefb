"""A field takes on what was fine-tuned for a subject, and only that subject's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from gazenerf.errors import UserError
from gazenerf.field.model import TwoStreamField
from gazenerf.field.plane import FeaturePlane, plane_coordinates
from gazenerf.geometry import Camera, Gaze
from gazenerf.heads import Head
from gazenerf.personal_weights import PersonalWeights
from gazenerf.subjects import Subject
from tests.field_doubles import make_field, make_subject, tiny_config

CAMERA, GAZE = Camera.neutral(32), Gaze(0.1, -0.2)
LAST = "streams.face.feature_2.bias"


def changes(field: TwoStreamField, seed: int = 0) -> dict[str, np.ndarray]:
    """Feature layers of both streams, and a plane for the face."""
    rng = np.random.default_rng(seed)
    names = [name for name in field.state_dict() if ".feature_" in name]
    found = {name: 0.2 * rng.standard_normal(tuple(field.state_dict()[name].shape)) for name in names}
    found["streams.face.plane.values"] = rng.standard_normal((3, 8, 16))
    found["streams.face.plane.mix"] = rng.standard_normal((field.config.hidden // 2, 3))
    return {name: value.astype(np.float16) for name, value in found.items()}


def tuned(field: TwoStreamField, subject: Subject, seed: int = 0) -> Subject:
    return replace(subject, personal=PersonalWeights(field.weights_hash, changes(field, seed)))


@pytest.fixture
def field() -> TwoStreamField:
    made = make_field(tiny_config())
    made.weights_hash = "0123456789abcdef"
    return made


@pytest.fixture
def subject(field: TwoStreamField) -> Subject:
    return make_subject(field.config)


def picture(field: TwoStreamField, subject: Subject) -> np.ndarray:
    return Head(field, subject).at(GAZE).render(CAMERA).image


def test_a_fine_tuned_subject_is_drawn_by_its_own_weights(field: TwoStreamField, subject: Subject) -> None:
    before = picture(field, subject)
    assert np.abs(picture(field, tuned(field, subject)) - before).max() > 0.05
    np.testing.assert_array_equal(picture(field, subject), before)


@pytest.mark.parametrize("geometry", ["density", "distance"])
def test_the_fast_path_equals_the_published_path(geometry: str) -> None:
    field = make_field(tiny_config()) if geometry == "density" else TwoStreamField(tiny_config(geometry="distance"))
    bound = Head(field.eval(), tuned(field, make_subject(field.config)), sampler="slabs").at(GAZE)
    camera = Camera.neutral(field.config.image_size)
    slow = bound.render_slow(camera)["image"][0].permute(1, 2, 0).numpy()
    np.testing.assert_allclose(bound.render(camera).image, slow, atol=2e-5)


def test_geometry_is_held(field: TwoStreamField, subject: Subject) -> None:
    points = torch.rand(200, 3) * 2.0 - 1.0
    first, second = Head(field, subject).at(GAZE), Head(field, tuned(field, subject)).at(GAZE)
    torch.testing.assert_close(second.density(points), first.density(points))


def test_another_person_or_path_begins_with_the_field_as_it_was_trained(
    field: TwoStreamField, subject: Subject
) -> None:
    mine = Head(field, tuned(field, subject))
    other = tuned(field, subject, seed=1)
    np.testing.assert_array_equal(picture(mine.field, subject), picture(field, subject))
    np.testing.assert_array_equal(picture(mine.field, other), picture(field, other))
    again = mine.with_sampler("slabs")
    torch.testing.assert_close(again.field.state_dict()[LAST], mine.field.state_dict()[LAST])
    assert mine.weights_hash == field.weights_hash and mine.field.state_dict().keys() >= field.state_dict().keys()


def test_weights_of_another_field_are_left_out_which_is_said(field: TwoStreamField, subject: Subject) -> None:
    foreign = replace(subject, personal=PersonalWeights("another", changes(field)))
    with pytest.warns(UserWarning, match=r"fine-tuned to another field \(another\).*left out"):
        head = Head(field, foreign)
    assert head.field is field


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("streams.face.nothing", np.zeros(3, np.float16), "no weights streams.face.nothing"),
        (LAST, np.zeros(3, np.float16), r"feature_2.bias is \(3,\) instead of"),
        ("streams.face.plane.mix", np.zeros((5, 3), np.float16), "the face stream's plane has the shapes"),
    ],
)
def test_weights_that_do_not_fit_are_one_line(
    field: TwoStreamField, subject: Subject, name: str, value: np.ndarray, message: str
) -> None:
    bad = replace(subject, personal=PersonalWeights(field.weights_hash, changes(field) | {name: value}))
    with pytest.raises(UserError, match=message):
        Head(field, bad)


def test_a_plane_is_looked_up_by_direction_and_goes_on_behind_the_head() -> None:
    values = torch.zeros(1, 4, 8)
    values[0, 1, 6], values[0, 2, 0], values[0, 2, 7] = 5.0, 1.0, 3.0
    plane = FeaturePlane(values, torch.tensor([[1.0], [2.0]]))
    at = torch.tensor([[6.5 / 8, 1.5 / 4], [0.5 / 8, 2.5 / 4], [0.0, 2.5 / 4], [1.0, 2.5 / 4]]) * 2.0 - 1.0
    azimuth, elevation = np.pi * at[:, 0].numpy(), 0.5 * np.pi * at[:, 1].numpy()
    points = np.stack(
        [np.sin(azimuth) * np.cos(elevation), np.sin(elevation), np.cos(azimuth) * np.cos(elevation)], axis=-1
    )
    rays = torch.from_numpy(0.7 * points)[None].float()
    torch.testing.assert_close(plane_coordinates(rays)[0, :2], at[:2], atol=1e-5, rtol=0.0)
    found = plane(rays)[0].detach()
    torch.testing.assert_close(found[:, 0], torch.tensor([5.0, 1.0, 2.0, 2.0]), atol=1e-4, rtol=0.0)
    torch.testing.assert_close(found[:, 1], 2.0 * found[:, 0])
    assert plane(torch.zeros(1, 0, 3)).shape == (1, 0, 2)
