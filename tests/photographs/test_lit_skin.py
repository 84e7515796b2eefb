"""Colours of skin that follow shape, texture and light, and a fit of all of them together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from gazenerf.data.rasterizer import Rasterizer
from gazenerf.head_model.interface import FACE
from gazenerf.head_model.points import double
from gazenerf.head_model.sampling import sample_person
from gazenerf.head_model.shading import shade, spherical_harmonics
from gazenerf.photographs.appearance import Seen
from gazenerf.photographs.correspondence import table_for
from gazenerf.photographs.lit_skin import LitSkin
from gazenerf.photographs.looks import LitVertices, LookPriors, harmonics
from gazenerf.photographs.picture_terms import Observed
from gazenerf.photographs.seen_skin import seen_skin
from gazenerf.photographs.shape_fit import PictureFit, ShapeFit, _Problem

SAME = np.array([[1.0, 1.0], [0.0, 0.0]])


@pytest.fixture(scope="module")
def vertices(model, rendered) -> np.ndarray:
    """Skin that faces forward."""
    mesh = rendered[0].mesh
    ahead = np.unique(mesh.part_faces(FACE))
    ahead = ahead[mesh.normals[ahead, 2] > 0.3]
    return np.random.default_rng(0).permutation(ahead)[:400]


def places(mesh, skin: LitSkin) -> torch.Tensor:
    return double(mesh.vertices[skin.vertices])


def test_harmonics_are_those_of_the_head_model():
    directions = np.random.default_rng(0).normal(size=(50, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    np.testing.assert_allclose(harmonics(double(directions)).numpy(), spherical_harmonics(directions), atol=1e-12)


def test_colours_are_those_that_the_head_is_drawn_in(model, rendered, vertices):
    item = rendered[0]
    lit = LitVertices.of(model, vertices, item.mesh.occlusion)
    codes = item.codes
    found = lit.colours(double(item.mesh.normals[vertices]), double(codes.texture), double(codes.illumination))
    drawn = shade(item.mesh, codes.illumination)[vertices]
    np.testing.assert_allclose(found.clamp(0.0, 1.0).numpy(), drawn, atol=2e-3)
    skin = LitSkin.of(model, item.mesh, vertices)
    same = skin.colours(places(item.mesh, skin), double(codes.texture), double(codes.illumination))
    np.testing.assert_allclose(same.numpy(), found.numpy(), atol=1e-6)


def test_normals_turn_with_the_shape(model, rendered, vertices):
    """Of another identity: nearly its own shading, which held normals miss by far."""
    item = rendered[0]
    looks = double(item.codes.texture), double(item.codes.illumination)
    skin = LitSkin.of(model, item.mesh, vertices)
    other = model.mesh(replace(item.codes, identity=-item.codes.identity), item.gaze)
    true = LitVertices.of(model, vertices, item.mesh.occlusion).colours(double(other.normals[vertices]), *looks)
    turned = (skin.colours(places(other, skin), *looks) - true).abs().median()
    held = (skin.colours(places(item.mesh, skin), *looks) - true).abs().median()
    assert float(turned) < 0.4 * float(held) and float(held) > 0.005


def test_gradients_are_those_of_differences(model, rendered, vertices):
    item = rendered[0]
    skin = LitSkin.of(model, item.mesh, vertices[:5])
    start = [places(item.mesh, skin), double(item.codes.texture), double(item.codes.illumination)]
    start = [part.requires_grad_(True) for part in start]
    assert torch.autograd.gradcheck(lambda *parts: skin.colours(*parts).sum(dim=0), start, eps=1e-6, atol=1e-5)


def test_usual_people_cost_as_much_as_their_number_of_codes(model):
    priors, rng = LookPriors.of(model), np.random.default_rng(5)
    people = [sample_person(rng, model) for _ in range(50)]
    usual = [
        float(priors.cost(double(person.texture), double(person.illumination)[None])) for person in people
    ]  # fmt: skip
    assert 10.0 < np.median(usual) < 60.0
    strange = double(people[0].texture), 10.0 * double(people[0].illumination)[None]
    assert float(priors.cost(*strange)) > 3.0 * max(usual)


@pytest.fixture(scope="module")
def problem(model, rendered, landmarks):
    """The true head of a person, drawn in the light of another, and where the fit begins."""
    item, other = rendered[0], rendered[1]
    with Rasterizer((item.camera.width, item.camera.height), 2) as rasterizer:
        raster = rasterizer.render_lit(item.mesh, other.codes.illumination, item.camera)
    seen = Seen(item.image, landmarks[0], item.camera, item.mesh, raster)
    looks = item.codes.texture, other.codes.illumination
    skin = seen_skin(model, seen, looks, raster.image, 1.2, SAME)
    observed = Observed(landmarks[0], (item.camera.width, item.camera.height), skin=skin)
    table = table_for(model, dense=True)
    none = np.zeros(len(table.landmarks))
    picture = PictureFit(
        item.camera, item.gaze, item.codes.expression, np.zeros(len(table.components_mm)), none, none,
        np.zeros((len(none), 2)), 1.0,
    )  # fmt: skip
    start = ShapeFit(item.codes.identity, [picture], 0.0)
    return observed, table, start


def test_light_is_fitted_with_the_shape_and_a_known_texture_is_held(model, rendered, problem):
    observed, table, start = problem
    found = {}
    for known in (False, True):
        fit = _Problem(model, [observed], table, (True, known))
        begun = fit.values(start)
        ended, cost = fit.minimised(begun, 30)
        before, after = fit.looks(double(begun)), fit.looks(double(ended))
        assert len(before[0]) == model.code_sizes[2] and before[1].shape == (1, 27)
        assert torch.allclose(before[0], after[0], rtol=0.0, atol=1e-12) == known
        true = double(rendered[0].codes.illumination)
        assert (after[1][0] - true).norm() < 0.7 * (before[1][0] - true).norm()
        assert cost < 0.7 * float(fit.cost(double(begun)))
        found[known] = cost
    assert found[False] < 1.05 * found[True], "thirty steps are not the end of either"


def test_without_skin_there_are_neither_texture_nor_light(model, problem):
    observed, table, start = problem
    fit = _Problem(model, [replace(observed, skin=None)], table)
    assert [part.numel() for part in fit.looks(double(fit.values(start)))] == [0, 0]
