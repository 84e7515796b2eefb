"""Points about people's surfaces, with their distances."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from gazenerf.data.surface_points import (
    AHEAD,
    ANYWHERE,
    NEAR,
    OPENINGS,
    SURFACE,
    SurfacePoints,
    closed_surfaces,
    draw_person,
    lid_vertices,
    lip_vertices,
    opening_points,
    points_of,
    signed_distance,
    template_of,
)
from gazenerf.geometry import Gaze
from gazenerf.head_model import load_head_model
from gazenerf.head_model.follow import codes_at
from gazenerf.head_model.interface import FACE, HeadMesh


@pytest.fixture(scope="module")
def person() -> tuple[HeadMesh, dict[str, SurfacePoints]]:
    rng, model = np.random.default_rng(4), load_head_model()
    codes, gaze = draw_person(rng, model, (25.0, 35.0))
    mesh = model.mesh(codes, gaze)
    found = {part: points_of(mesh, template_of(model), part, codes, gaze, rng) for part in ("face", "eyes")}
    for points in found.values():
        assert points.shape_code[0].numpy() == pytest.approx(codes_at(codes, gaze).shape_code)
        assert points.gaze[0].tolist() == pytest.approx([gaze.pitch, gaze.yaw])
    return mesh, found


@pytest.mark.parametrize("part", ["face", "eyes"])
def test_points_lie_where_their_distances_say(person: tuple[HeadMesh, dict[str, SurfacePoints]], part: str) -> None:
    mesh, points = person[0], person[1][part]
    surface, normals = points.surface[0].numpy(), points.normals[0].numpy()
    assert surface.shape == normals.shape == (SURFACE, 3)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-5)
    surfaces = closed_surfaces(mesh, part)
    assert np.abs(signed_distance(mesh.vertices, surface, *surfaces)).max() < 1e-4
    for step in (-0.01, 0.01):  # a millimetre along the normals
        off = signed_distance(mesh.vertices, surface + step * normals, *surfaces)
        assert np.median(off) == pytest.approx(step, rel=0.05) and np.mean(np.sign(off) == np.sign(step)) > 0.97
    distance = points.distance[0].numpy()
    assert 0.25 < (distance[:NEAR] < 0).mean() < 0.6
    assert distance[NEAR : NEAR + ANYWHERE].max() > 0.2


def test_the_mouth_and_sockets_are_sampled_rarely(person: tuple[HeadMesh, dict[str, SurfacePoints]]) -> None:
    mesh, points = person
    assert mesh.occlusion is not None
    nearest = ((points["face"].surface[0, :400, None].numpy() - mesh.vertices[None, ::7]) ** 2).sum(-1).argmin(1)
    assert np.mean(mesh.occlusion[::7][nearest] < 0.2) < 0.05


def test_lids_and_what_is_between_them_are_sampled_densely(person: tuple[HeadMesh, dict[str, SurfacePoints]]) -> None:
    mesh, points = person
    model = load_head_model()
    template = template_of(model)
    lids = lid_vertices(template)
    assert 0.02 < lids.mean() < 0.2 and (template.vertices[lids][:, 2] > 0.7).all()
    places = points["face"].places[0].numpy()
    nearest = ((places[::6, None] - template.vertices[None]) ** 2).sum(-1).argmin(1)
    assert 0.15 < lids[nearest].mean() < 0.5
    eyes = np.unique(mesh.faces[mesh.face_part != FACE])
    ahead = points["face"].points[0, -OPENINGS:].numpy()
    away = np.sqrt(((ahead[:, None] - mesh.vertices[eyes][None]) ** 2).sum(-1).min(1))
    assert away.max() < AHEAD + 0.02 and (points["face"].distance[0, -OPENINGS:] > 0.01).float().mean() > 0.1


def test_lips_and_what_is_between_them_are_sampled_densely() -> None:
    rng, model = np.random.default_rng(4), load_head_model()
    template = template_of(model)
    lips = lip_vertices(template)
    assert 0.005 < lips.mean() < 0.1
    middle = 0.5 * (template.landmarks["62"] + template.landmarks["66"])
    assert np.abs(template.vertices[lips] - middle).max(0) == pytest.approx([0.37, 0.2, 0.25], abs=0.15)
    codes, gaze = draw_person(rng, model, (25.0, 35.0))
    air = []
    for jaw in (0.0, 0.6):
        expression = np.zeros_like(codes.expression)
        expression[model.expression_names.index("jawOpen")] = jaw
        mesh = model.mesh(replace(codes, expression=expression), gaze)
        points = opening_points(mesh, 2000, rng)
        air.append(
            np.mean(signed_distance(mesh.vertices, points.astype(np.float32), *closed_surfaces(mesh, "face")) > 0.01)
        )
        found = points_of(mesh, template, "face", codes, gaze, rng)
        nearest = ((found.places[0, ::6, None].numpy() - template.vertices[None]) ** 2).sum(-1).argmin(1)
        assert 0.04 < lips[nearest].mean() < 0.4
    assert air[0] < 0.45 and air[1] > 0.6, air


def test_the_template_may_have_an_open_mouth() -> None:
    model = load_head_model()
    shut, opened = template_of(model), template_of(model, 0.25)
    gaps = [np.linalg.norm(head.landmarks["62"] - head.landmarks["66"]) for head in (shut, opened)]
    assert gaps[0] < 0.02 and 0.06 < gaps[1] < 0.15
    np.testing.assert_array_equal(opened.eye_centres, shut.eye_centres)
    assert np.abs(opened.vertices - shut.vertices)[shut.vertices[:, 1] > 0.3].max() < 0.02


def test_some_people_open_their_mouths() -> None:
    model = load_head_model()
    jaw = model.expression_names.index("jawOpen")
    jaws = np.array([draw_person(np.random.default_rng(i), model, (20.0, 20.0))[0].expression[jaw] for i in range(80)])
    assert 0.15 < (jaws > 0.25).mean() < 0.6


def test_people_are_joined_and_look_within_the_range() -> None:
    rng, model = np.random.default_rng(0), load_head_model()
    drawn = [draw_person(rng, model, (10.0, 20.0))[1] for _ in range(40)]
    pitch, yaw = np.abs([gaze.degrees for gaze in drawn]).max(0)
    assert 7.0 < pitch <= 10.0 and 14.0 < yaw <= 20.0 and Gaze() in drawn
    one = SurfacePoints(*(torch.rand(1, *shape) for shape in ((3,), (4,), (2,), (5, 3), (5, 3), (5, 3), (6, 3), (6,))))
    both = SurfacePoints.joined([one, one])
    assert len(both) == 2 and both.points.shape == (2, 6, 3) and torch.equal(both.gaze[0], both.gaze[1])
