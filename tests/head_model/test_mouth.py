"""Teeth, gums and tongue of the bundled head."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh

from gazenerf.data.surface_points import closed_surfaces, draw_person
from gazenerf.errors import UserError
from gazenerf.geometry import Camera, Gaze
from gazenerf.head_model import FACE, MOUTH, HeadMesh, load_head_model
from gazenerf.head_model.assets import BUNDLED, read_arrays
from gazenerf.head_model.mouth import LEAST, light_behind_lips
from gazenerf.head_model.ray_scenes import ray_scene, tensor
from gazenerf.head_model.sampling import sample_person


def head(seed: int = 3, **expression: float) -> HeadMesh:
    model = load_head_model()
    codes = sample_person(np.random.default_rng(seed), model)
    coefficients = np.array([expression.get(name, 0.0) for name in model.expression_names], np.float32)
    return model.mesh(replace(codes, expression=coefficients), Gaze())


def behind_lips(mesh: HeadMesh) -> np.ndarray:
    return np.unique(mesh.part_faces(MOUTH))


def test_each_row_of_teeth_and_the_tongue_are_closed_and_turned_outward() -> None:
    mesh = head(jawOpen=0.4)
    _, *pieces = closed_surfaces(mesh, "face")
    assert len(pieces) == 3
    for faces in pieces:
        solid = trimesh.Trimesh(mesh.vertices, faces, process=True)
        assert solid.is_watertight and solid.is_winding_consistent and solid.volume > 1e-3


def test_the_jaw_takes_the_lower_row_and_the_tongue_with_it() -> None:
    shut, opened = head(), head(jawOpen=0.5)
    upper, lower, tongue = (np.unique(faces) for faces in closed_surfaces(shut, "face")[1:])
    moved = opened.vertices - shut.vertices
    assert np.abs(moved[upper]).max() < 1e-6
    chin = shut.landmarks["8"][1] - opened.landmarks["8"][1]
    assert chin > 0.05
    for part in (lower, tongue):
        assert -np.median(moved[part, 1]) > 0.05


@pytest.mark.parametrize("names", [("mouthPressLeft", "mouthPressRight"), ("mouthRollLower", "mouthRollUpper"), ()])
def test_no_tooth_comes_through_closed_lips(names: tuple[str, ...]) -> None:
    for seed in range(12):
        assert outside_the_lips(head(seed, **dict.fromkeys(names, 0.9))) == 0


def test_no_tooth_comes_through_the_skin_of_any_face() -> None:
    model, rng = load_head_model(), np.random.default_rng(8)
    poked = 0
    for _ in range(40):
        codes, gaze = draw_person(rng, model, (25.0, 35.0))
        poked += outside_the_lips(model.mesh(codes, gaze)) > 0
    assert poked <= 1


def outside_the_lips(mesh: HeadMesh) -> int:
    """Pixels seen from the front that show teeth or tongue where no opening of the mouth is."""
    camera = Camera.look_at(mesh.landmarks["62"] + np.array([0.0, 0.0, 8.0]), mesh.landmarks["62"], size=160, fov=0.12)
    origins, directions = camera.rays()
    rays = np.concatenate([origins, directions], axis=-1).reshape(-1, 6)
    hits = ray_scene(mesh.vertices, mesh.part_faces(FACE), mesh.part_faces(MOUTH)).cast_rays(tensor(rays))
    teeth = hits["geometry_ids"].numpy().reshape(160, 160) == 1
    lips, _ = camera.project(np.stack([mesh.landmarks[str(i)] for i in range(60, 68)]).astype(np.float64))
    opening = np.zeros((160, 160), np.uint8)
    cv2.fillPoly(opening, [cv2.convexHull(np.round(lips).astype(np.int32))], 1)
    return int((teeth & (cv2.dilate(opening, np.ones((15, 15), np.uint8)) == 0)).sum())


def test_what_lies_behind_closed_lips_is_dark() -> None:
    light = {}
    for name, amount in (("shut", 0.0), ("parted", 0.15), ("open", 0.6)):
        mesh = head(jawOpen=amount)
        assert mesh.occlusion is not None
        light[name] = mesh.occlusion[behind_lips(mesh)]
    assert light["shut"].mean() < light["parted"].mean() < light["open"].mean()
    assert light["shut"].min() >= LEAST - 1e-6 and light["open"].max() <= 1.0
    mesh = head(jawOpen=0.6)
    depth = mesh.vertices[behind_lips(mesh), 2]
    assert np.corrcoef(depth, light["open"])[0, 1] > 0.5


def test_light_reaches_no_vertices_where_there_are_none() -> None:
    marks = np.stack([head().landmarks[str(i)] for i in range(68)])
    assert light_behind_lips(np.zeros((0, 3), np.float32), marks).shape == (0,)


def test_albedo_is_that_of_the_mesh_whatever_the_texture() -> None:
    model, mesh = load_head_model(), head()
    vertices = behind_lips(mesh)[::50]
    albedo = model.albedo_at(vertices)
    assert not albedo.basis.any()
    np.testing.assert_allclose(albedo.at(np.ones(model.code_sizes[2])), mesh.albedo[vertices], atol=1e-6)


def test_a_head_model_without_a_mouth_loads_and_has_the_same_skin(tmp_path: Path) -> None:
    arrays = {name: array for name, array in read_arrays(BUNDLED).items() if not name.startswith("mouth_")}
    np.savez(tmp_path / "bare.npz", **arrays)
    bare, model = load_head_model(tmp_path / "bare.npz"), load_head_model()
    codes = sample_person(np.random.default_rng(0), model)
    ours, theirs = model.mesh(codes, Gaze()), bare.mesh(codes, Gaze())
    assert not len(theirs.part_faces(MOUTH))
    np.testing.assert_array_equal(ours.vertices[: len(theirs.vertices)], theirs.vertices)
    assert len(closed_surfaces(theirs, "face")) == 1


@pytest.mark.parametrize("name", ["mouth_faces", "mouth_columns", "mouth_rows", "mouth_identity"])
def test_a_damaged_mouth_is_refused_in_one_line(tmp_path: Path, name: str) -> None:
    arrays = read_arrays(BUNDLED)
    arrays[name] = arrays[name][:1] if name == "mouth_identity" else arrays[name] + 9999
    np.savez(tmp_path / "broken.npz", **arrays)
    with pytest.raises(UserError, match="is not a head model"):
        load_head_model(tmp_path / "broken.npz")
