"""Upper lids follow the gaze, and fields are asked with the expression that this makes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from gazenerf.geometry import Gaze
from gazenerf.geometry.gaze import outward
from gazenerf.head_model import FACE, load_head_model
from gazenerf.head_model.follow import codes_at
from gazenerf.head_model.lids import followed
from gazenerf.head_model.ray_scenes import ray_scene, tensor
from gazenerf.loading import load
from gazenerf.subjects import Codes, load_subject

NAMES = ("eyeBlinkLeft", "eyeWideLeft", "eyeBlinkRight", "eyeWideRight", "jawOpen")


def codes_with(**amounts: float) -> Codes:
    """A mean face with some coefficients, each of both sides."""
    model = load_head_model()
    codes = Codes(*(np.zeros(size, np.float32) for size in model.code_sizes))
    expression = codes.expression.copy()
    for name, amount in amounts.items():
        for side in ("Left", "Right"):
            expression[model.expression_names.index(name + side)] = amount
    return replace(codes, expression=expression)


def open_degrees(codes: Codes, pitch: float) -> tuple[float, float] | None:
    """Elevations between which nothing lies before the middle of the left eyeball; None where the eye is shut."""
    mesh = load_head_model().mesh(codes, Gaze.from_degrees(pitch, 0.0))
    elevation = np.deg2rad(np.linspace(-50.0, 50.0, 401))
    directions = outward(elevation, np.zeros_like(elevation))
    rays = np.concatenate([mesh.eye_centres[0] + 0.97 * mesh.eye_radius * directions, directions], axis=-1)
    scene = ray_scene(mesh.vertices, mesh.part_faces(FACE))
    seen = np.rad2deg(elevation[scene.cast_rays(tensor(rays))["t_hit"].numpy() > mesh.eye_radius])
    return (float(seen.min()), float(seen.max())) if len(seen) else None


def test_upper_lids_go_with_the_gaze_nearly_degree_for_degree() -> None:
    uppers = []
    for pitch in (-28.0, -20.0, 0.0, 20.0):
        found = open_degrees(codes_with(), pitch)
        assert found is not None
        uppers.append(found[1])
    far, low, middle, high = uppers
    assert 0.9 < (middle - low) / 20.0 < 1.15 and 0.9 < (middle - far) / 28.0 < 1.15
    assert 0.6 < (high - middle) / 20.0 < 1.0


@pytest.mark.parametrize("pitch", [-28.0, 0.0, 25.0])
def test_shut_eyes_stay_shut(pitch: float) -> None:
    assert open_degrees(codes_with(eyeBlink=0.8), pitch) is None


@pytest.mark.parametrize("pitch", [-0.3, 0.2])
def test_half_shut_lids_follow_less_and_other_coefficients_not_at_all(pitch: float) -> None:
    def moved(blink: float) -> np.ndarray:
        expression = torch.tensor([blink, 0.0, 0.0, 0.0, 0.4], dtype=torch.float64)
        return (followed(NAMES, expression, torch.tensor(pitch, dtype=torch.float64)) - expression).numpy()

    left = [np.abs(moved(blink)[:2]).max() for blink in (0.0, 0.2, 0.5, 0.75, 0.9)]
    assert (np.diff(left[:4]) < 0.0).all() and left[3] == left[4] == 0.0
    assert np.abs(moved(0.75)[2:4]).max() == left[0], "the other eye is open"
    assert not moved(0.0)[4]


def test_wide_eyes_get_no_wider_than_a_whole_coefficient() -> None:
    expression = torch.tensor([0.0, 0.8, 0.0, 1.0, 0.0], dtype=torch.float64)
    found = followed(NAMES, expression, torch.tensor(0.5, dtype=torch.float64))
    assert 0.8 < found[1] <= 1.05 and found[3] == 1.0


def test_gradients_flow_to_expression_and_gaze() -> None:
    start = torch.tensor([0.3, 0.1, 0.05, 0.2, 0.4], dtype=torch.float64, requires_grad=True)
    pitch = torch.tensor(-0.2, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda e, p: followed(NAMES, e, p), (start, pitch))


def test_models_without_these_names_do_not_follow() -> None:
    expression = torch.tensor([0.3, 0.1], dtype=torch.float64)
    assert torch.equal(followed(("a", "b"), expression, torch.tensor(0.3)), expression)
    assert followed((), torch.zeros(0), torch.tensor(0.3)).shape == (0,)


def test_codes_at_a_gaze_have_the_expression_of_the_head_models_mesh() -> None:
    """What a field learned of straight lids and expressions tells where they are at any gaze."""
    model, gaze = load_head_model(), Gaze.from_degrees(-18.0, 12.0)
    codes = codes_with(eyeBlink=0.2)
    at = codes_at(codes, gaze)
    looks = np.array([name.startswith("eyeLook") for name in model.expression_names])
    np.testing.assert_allclose(at.expression[~looks], model.driven(codes.expression, gaze)[~looks], atol=1e-7)
    assert not at.expression[looks].any() and (at.expression != codes.expression).sum() == 2
    np.testing.assert_array_equal(codes_at(codes, Gaze.from_degrees(0.0, 30.0)).expression, codes.expression)


def test_codes_of_other_sizes_stay_as_they_are() -> None:
    codes = Codes(*(np.ones(size, np.float32) for size in (3, 4, 5, 27)))
    assert codes_at(codes, Gaze.from_degrees(-20.0, 0.0)) is codes


def test_a_field_is_asked_with_the_codes_at_the_gaze() -> None:
    head = load("jana", checkpoint="small")
    gaze, jana = Gaze.from_degrees(-20.0, 0.0), load_subject("jana").codes
    shape = torch.from_numpy(codes_at(jana, gaze).shape_code)[None]
    appearance = torch.from_numpy(jana.appearance_code)[None]
    bound = head.at(gaze)
    with head.exactly():
        wanted = head.field.condition("face", shape, appearance, bound.label)
    assert torch.equal(bound.conditions["face"].first, wanted.first)
    assert not np.array_equal(codes_at(jana, gaze).expression, jana.expression)
