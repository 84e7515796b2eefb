"""The differentiable points and albedo that fits use are those of the mesh."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from gazenerf.geometry import Gaze
from gazenerf.head_model import GenericHead, load_head_model
from gazenerf.head_model.expressions import sample_expressions
from gazenerf.head_model.points import double
from gazenerf.head_model.sampling import sample_person
from gazenerf.subjects import Codes


def generic() -> GenericHead:
    """A part of the bundled head as a user's file would have it, in metres."""
    model = load_head_model()
    mesh = model.mesh(Codes(*(np.zeros(size) for size in model.code_sizes)), Gaze())
    count, rng = len(model.albedo_mean), np.random.default_rng(0)
    arrays = {
        "vertices": mesh.vertices[:count] * 0.1,
        "faces": mesh.faces[:100],
        "eye_centres": mesh.eye_centres * 0.1,
        "landmarks": model.landmarks,
        "metres_per_unit": np.array(1.0),
        "identity": rng.normal(size=(5, count, 3)) * 0.001,
        "eye_centres_identity": rng.normal(size=(5, 2, 3)) * 0.001,
        "expression": rng.normal(size=(3, count, 3)) * 0.001,
        "expression_names": np.array(["jawOpen", "eyeLookUpLeft", "eyeLookInRight"]),
        "albedo": rng.normal(size=(4, count, 3)) * 0.1,
    }
    return GenericHead(arrays, "other.npz")


@pytest.mark.parametrize("kind", ["bundled", "generic"])
def test_points_are_those_of_the_mesh(kind):
    model = load_head_model() if kind == "bundled" else generic()
    rng = np.random.default_rng(1)
    vertices = np.unique(np.concatenate([rng.choice(len(model.albedo_mean), 300), model.landmark_vertices]))
    points = model.skin_points(vertices)
    for _ in range(4):
        person = sample_person(rng, model)
        gaze = Gaze(float(rng.uniform(-0.4, 0.4)), float(rng.uniform(-0.6, 0.6)))
        codes = Codes(person.identity, sample_expressions(rng, model, gaze), person.texture, person.illumination)
        mesh = model.mesh(codes, gaze)
        found = points(double(codes.identity), double(codes.expression), double([gaze.pitch, gaze.yaw]))
        np.testing.assert_allclose(found.numpy(), mesh.vertices[vertices], atol=3e-5)
        np.testing.assert_allclose(points.eye_centres(double(codes.identity)).numpy(), mesh.eye_centres, atol=1e-5)
        assert points.radius == pytest.approx(mesh.eye_radius)


def test_gradients_are_those_of_differences():
    model = load_head_model()
    points = model.skin_points(model.landmark_vertices[[30, 37, 46, 57]])
    rng = np.random.default_rng(2)
    start = [double(rng.normal(size=size)) * 0.3 for size in (model.code_sizes[0], model.code_sizes[1], 2)]
    start = [part.clamp(-0.4, 0.4).requires_grad_(True) for part in start]
    assert torch.autograd.gradcheck(lambda *parts: points(*parts).sum(dim=0), start, eps=1e-6, atol=1e-5)


@pytest.mark.parametrize("kind", ["bundled", "generic"])
def test_albedo_is_that_of_the_mesh(kind):
    model = load_head_model() if kind == "bundled" else generic()
    rng = np.random.default_rng(3)
    person = sample_person(rng, model)
    mesh = model.mesh(person, Gaze())
    vertices = rng.choice(len(mesh.vertices), 500)
    vertices[:20] = len(mesh.vertices) - np.arange(1, 21)
    np.testing.assert_allclose(model.albedo_at(vertices).at(person.texture), mesh.albedo[vertices], atol=1e-5)
