"""Hair of the bundled head: cuts with volume, and a beard."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from gazenerf.errors import UserError
from gazenerf.geometry import Gaze
from gazenerf.head_model import FACE, HAIR, HeadMesh, load_head_model
from gazenerf.head_model.assets import BUNDLED, read_arrays
from gazenerf.head_model.expressions import sample_expressions
from gazenerf.head_model.ray_scenes import ray_scene, tensor
from gazenerf.head_model.sampling import STUBBLE, sample_hair, sample_person, with_hair
from gazenerf.subjects import Codes

SIDES = np.array([[0, 0, 1], [1, 0, 0], [-1, 0, 0], [0, 0, -1], [0, 1, 0.2]], float)


def cut(**amounts: float) -> np.ndarray:
    return np.array([amounts.get(name, 0.0) for name in load_head_model().hair_names], np.float32)


def head(seed: int = 3, hair: np.ndarray | None = None, **expression: float) -> HeadMesh:
    model = load_head_model()
    codes = sample_person(np.random.default_rng(seed), model)
    coefficients = np.array([expression.get(name, 0.0) for name in model.expression_names], np.float32)
    return model.mesh(replace(codes, expression=coefficients, hair=cut() if hair is None else hair), Gaze())


def seen_as_hair(mesh: HeadMesh, toward: np.ndarray, cells: int = 60) -> tuple[np.ndarray, np.ndarray]:
    """(N,) bool whether parallel rays against a direction meet hair first, and skin or hair at all."""
    back = toward / np.linalg.norm(toward)
    across = np.cross(back, [0.0, 1.0, 0.01])
    across /= np.linalg.norm(across)
    up = np.cross(across, back)
    u, v = np.meshgrid(np.linspace(-1.5, 1.5, cells), np.linspace(-1.8, 1.7, cells))
    origins = 5.0 * back + u.reshape(-1, 1) * across + v.reshape(-1, 1) * up
    rays = np.concatenate([origins, np.broadcast_to(-back, origins.shape)], axis=1)
    parts = mesh.part_faces(FACE), mesh.part_faces(HAIR)
    found = ray_scene(mesh.vertices, *parts).cast_rays(tensor(rays))
    number = found["geometry_ids"].numpy()
    return number == 1, np.isfinite(found["t_hit"].numpy())


def test_no_hair_code_and_a_code_of_zeros_are_the_head_without_hair() -> None:
    model = load_head_model()
    person = sample_person(np.random.default_rng(1), model)
    plain, zeros = model.mesh(person, Gaze()), model.mesh(replace(person, hair=cut()), Gaze())
    assert not len(plain.part_faces(HAIR)) and not len(zeros.part_faces(HAIR))
    np.testing.assert_array_equal(plain.vertices, zeros.vertices)
    hairy = model.mesh(replace(person, hair=cut(crop=1.0)), Gaze())
    np.testing.assert_array_equal(hairy.vertices[: len(plain.vertices)], plain.vertices)
    np.testing.assert_array_equal(hairy.faces[: len(plain.faces)], plain.faces)


@pytest.mark.parametrize("name", load_head_model().hair_names)
def test_every_cut_is_one_closed_surface_turned_outward(name: str) -> None:
    mesh = head(hair=cut(**{name: 1.0}))
    solid = trimesh.Trimesh(mesh.vertices, mesh.part_faces(HAIR), process=True)
    assert solid.is_watertight and solid.is_winding_consistent and solid.volume > 0.5
    assert solid.body_count == 1


def test_hair_that_is_not_raised_stays_under_the_skin_whatever_the_face_does() -> None:
    model, shown, seen = load_head_model(), 0, 0
    for seed in range(12):
        rng = np.random.default_rng(seed)
        person = sample_person(rng, model)
        expression = sample_expressions(rng, model, Gaze())
        expression[model.expression_names.index("jawOpen")] = 0.1 * seed % 0.9
        mesh = model.mesh(replace(person, expression=expression, hair=cut(crop=1e-4)), Gaze())
        for toward in SIDES:
            hair, hit = seen_as_hair(mesh, toward)
            shown, seen = shown + hair.sum(), seen + hit.sum()
    assert shown < 1e-3 * seen


@pytest.mark.parametrize(
    ("code", "where"),
    [("crop", [0.0, 1.1, -0.3]), ("top", [0.0, 1.1, 0.0]), ("round", [0.0, 0.6, -1.0]), ("fringe", [0.0, 0.6, 1.0]),
     ("bob", [0.9, -0.2, -0.1]), ("short_bob", [0.9, 0.0, -0.1]), ("beard", [0.0, -1.0, 1.0])],
)  # fmt: skip
def test_each_code_raises_hair_where_its_name_says(code: str, where: list[float]) -> None:
    toward = np.array(where)
    toward = toward / np.linalg.norm(toward)

    def reach(mesh: HeadMesh) -> float:
        near = [mesh.vertices[np.unique(mesh.part_faces(part))] for part in (FACE, HAIR)]
        return max(float((some @ toward)[np.linalg.norm(np.cross(some, toward), axis=1) < 0.25].max(initial=0.0))
                   for some in near)  # fmt: skip

    assert reach(head(hair=cut(**{code: 1.0}))) > reach(head()) + 0.03


def test_long_hair_covers_ears_and_neck_and_a_crop_does_not() -> None:
    long, short = head(hair=cut(bob=1.0, long=1.0)), head(hair=cut(crop=1.0))
    covered = {}
    for name, mesh in (("long", long), ("short", short)):
        hair, hit = seen_as_hair(mesh, np.array([0.0, 0.0, -1.0]))
        covered[name] = hair[hit].mean()
    assert covered["long"] > 0.8 and covered["short"] < 0.7
    ear = max(long.vertices[long.part_faces(FACE)].reshape(-1, 3)[:, 0])
    assert long.vertices[np.unique(long.part_faces(HAIR)), 0].max() > ear


def test_a_beard_goes_with_the_jaw_and_hair_does_not() -> None:
    shut, opened = head(hair=cut(crop=1.0, beard=1.0)), head(hair=cut(crop=1.0, beard=1.0), jawOpen=0.6)
    hair = np.unique(shut.part_faces(HAIR))
    moved = opened.vertices[hair] - shut.vertices[hair]
    place = shut.vertices[hair]
    chin = shut.landmarks["8"]
    on_chin = np.linalg.norm(place - chin, axis=1) < 0.2
    fall = shut.landmarks["8"][1] - opened.landmarks["8"][1]
    assert on_chin.any() and -moved[on_chin, 1].mean() > 0.7 * fall > 0.03
    assert np.abs(moved[place[:, 1] > 0.3]).max() < 1e-3


def test_hair_has_the_tone_of_painted_hair_and_darker_roots() -> None:
    model = load_head_model()
    person = sample_person(np.random.default_rng(2), model)
    fair = person.texture.copy()
    fair[6:8] = 2.0
    dark = model.mesh(replace(person, hair=cut(round=1.0)), Gaze())
    light = model.mesh(replace(person, texture=fair, hair=cut(round=1.0)), Gaze())
    hair = np.unique(dark.part_faces(HAIR))
    assert light.albedo[hair].mean() > 2.0 * dark.albedo[hair].mean()
    crop = model.mesh(replace(person, hair=cut(crop=0.5)), Gaze())
    assert dark.occlusion is not None and crop.occlusion is not None
    assert dark.occlusion[hair].max() > crop.occlusion[hair].mean()


def test_drawn_cuts_are_plausible_and_come_from_the_generator_alone() -> None:
    model = load_head_model()
    drawn = np.stack([sample_hair(np.random.default_rng(seed), model) for seed in range(200)])
    again = np.stack([sample_hair(np.random.default_rng(seed), model) for seed in range(200)])
    np.testing.assert_array_equal(drawn, again)
    shaved = (drawn == 0.0).all(axis=1).mean()
    assert 0.05 < shaved < 0.3 and (drawn > 0.0).any(axis=0).all()
    names = model.hair_names
    bearded = 0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        person = sample_person(rng, model)
        hairy = with_hair(rng, model, person)
        if hairy.hair[names.index("beard")] > 0.0:
            bearded += 1
            assert hairy.texture[STUBBLE] >= 1.5
        else:
            np.testing.assert_array_equal(hairy.texture, person.texture)
    assert bearded


def test_a_short_bob_covers_the_ears_and_leaves_what_is_below_them_free() -> None:
    below = {}
    for name in ("bob", "short_bob"):
        mesh = head(hair=cut(crop=0.4, **{name: 1.0}))
        places = mesh.vertices[np.unique(mesh.part_faces(HAIR))]
        beside = np.abs(places[:, 0]) > 0.85  # as far out as ears reach
        assert places[beside, 1].max() > 0.0
        below[name] = places[beside, 1].min()
    assert below["bob"] < -0.7 < -0.45 < below["short_bob"]


def test_codes_of_before_a_cut_was_added_are_the_same_head() -> None:
    model = load_head_model()
    person = sample_person(np.random.default_rng(1), model)
    whole = cut(crop=0.5, bob=1.0, beard=0.7)
    before = model.mesh(replace(person, hair=whole[: model.hair_names.index("short_bob")]), Gaze())
    np.testing.assert_array_equal(before.vertices, model.mesh(replace(person, hair=whole), Gaze()).vertices)


def test_longer_codes_are_refused(tmp_path: Path) -> None:
    model = load_head_model()
    codes = Codes(*(np.zeros(size) for size in model.code_sizes), np.ones(len(model.hair_names) + 1))
    with pytest.raises(UserError, match="hair codes"):
        model.mesh(codes, Gaze())


def test_an_asset_without_hair_is_the_head_as_before_and_a_damaged_one_is_refused(tmp_path: Path) -> None:
    arrays = read_arrays(BUNDLED)
    bald = {name: value for name, value in arrays.items() if not name.startswith("hair_")}
    np.savez(tmp_path / "bald.npz", **bald)
    model = load_head_model(tmp_path / "bald.npz")
    assert model.hair_names == ()
    codes = sample_person(np.random.default_rng(0), load_head_model())
    np.testing.assert_array_equal(model.mesh(codes, Gaze()).vertices, load_head_model().mesh(codes, Gaze()).vertices)
    np.savez(tmp_path / "bad.npz", **{**arrays, "hair_faces": arrays["hair_faces"] + 10**6})
    with pytest.raises(UserError, match="hair_faces"):
        load_head_model(tmp_path / "bad.npz")
