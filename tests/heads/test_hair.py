"""The head model's hair on the bundled field of distances."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from gazenerf.checkpoints import load_field
from gazenerf.geometry import Camera, Gaze
from gazenerf.head_model import FACE, HAIR, load_head_model
from gazenerf.head_model.ray_scenes import ray_scene, tensor
from gazenerf.heads import Head
from gazenerf.heads.hair import CELL, hair_volume, takes_hair
from gazenerf.subjects import Codes, load_subject


def cut(**amounts: float) -> np.ndarray:
    return np.array([amounts.get(name, 0.0) for name in load_head_model().hair_names], np.float32)


@pytest.fixture(scope="module")
def field():
    return load_field("portrait-sdf")


@pytest.fixture(scope="module")
def heads(field) -> dict[str, Head]:
    subject = load_subject("noa")
    return {
        name: Head(field, replace(subject, codes=replace(subject.codes, hair=hair)))
        for name, hair in (("bald", cut()), ("round", cut(crop=0.8, round=1.0)))
    }


def test_a_volume_has_the_distances_of_the_head_models_hair(field) -> None:
    model = load_head_model()
    codes = replace(load_subject("noa").codes, hair=cut(crop=0.6, bob=1.0))
    volume = hair_volume(model.mesh(codes, Gaze()), field.template_jaw)
    assert volume is not None
    mesh = model.mesh(codes, Gaze())
    faces = mesh.part_faces(HAIR)
    rng = np.random.default_rng(0)
    on = mesh.vertices[faces[rng.integers(len(faces), size=4000)]].mean(axis=1)
    points = (on + 0.04 * rng.standard_normal(on.shape)).astype(np.float32)
    true = ray_scene(mesh.vertices, faces).compute_signed_distance(tensor(points)).numpy()
    found = volume.distance(torch.from_numpy(points)).numpy()
    assert np.abs(found - true).max() < CELL and np.median(np.abs(found - true)) < 0.05 * CELL


def test_roots_lie_on_the_templates_painted_hair(field) -> None:
    model = load_head_model()
    codes = replace(load_subject("noa").codes, hair=cut(crop=0.4, bob=1.0, beard=1.0))
    volume = hair_volume(model.mesh(codes, Gaze()), field.template_jaw)
    assert volume is not None
    none = Codes(*(np.zeros(size, np.float32) for size in model.code_sizes))
    none.expression[model.expression_names.index("jawOpen")] = field.template_jaw
    template = model.mesh(none, Gaze())
    mesh = model.mesh(codes, Gaze())
    hair = mesh.vertices[np.unique(mesh.part_faces(HAIR))][::50]
    roots = volume.root_places(torch.from_numpy(hair)).numpy()
    away = ray_scene(template.vertices, template.part_faces(FACE)).compute_distance(tensor(roots)).numpy()
    assert np.median(away) < 0.01 and (roots[:, 1] > -0.7).all()


def test_no_hair_is_no_volume_and_fields_of_densities_take_none(field) -> None:
    codes = replace(load_subject("noa").codes, hair=cut())
    assert hair_volume(load_head_model().mesh(codes, Gaze()), 0.0) is None
    assert Head(field, replace(load_subject("noa"), codes=codes)).hair is None
    assert takes_hair(field.config) and not takes_hair(load_field("portrait").config)


def test_hair_stands_out_where_the_head_model_has_it_and_the_face_stays(heads: dict[str, Head]) -> None:
    camera = Camera.orbit(yaw=np.pi / 2, size=64)
    depths = {}
    for name, head in heads.items():
        geometry = head.at(Gaze()).render_geometry(camera, "head")
        depths[name] = np.where(np.isfinite(geometry.depth), geometry.depth, 20.0)
    codes = replace(heads["round"].subject.codes)
    mesh = load_head_model().mesh(codes, Gaze())
    origins, directions = camera.rays()
    rays = np.concatenate([np.broadcast_to(origins, directions.shape), directions], axis=-1)
    true = ray_scene(mesh.vertices, mesh.part_faces(HAIR), mesh.part_faces(0)).cast_rays(tensor(rays))
    hit, part = true["t_hit"].numpy(), true["geometry_ids"].numpy()
    hair = (part == 0) & (depths["round"] < 20.0)
    raised = depths["bald"] - depths["round"]
    assert np.median(raised[hair]) > 0.15
    assert np.median(np.abs(depths["round"] - hit)[hair]) < 0.03
    skin = (part == 1) & np.isfinite(hit) & (depths["bald"] < 20.0)
    assert np.median(np.abs(raised[skin])) < 1e-4


def test_pictures_show_hair_and_hair_alone_has_changed(heads: dict[str, Head]) -> None:
    camera = Camera.neutral(128)
    bald, hairy = (head.at(Gaze()).render(camera).images["head"] for head in heads.values())
    changed = np.abs(bald - hairy).max(axis=-1) > 0.04
    assert changed[:40].sum() > 300
    eyes = heads["bald"].at(Gaze())
    del eyes
    middle = np.s_[60:110, 45:83]
    assert changed[middle].mean() < 0.02


def test_hair_codes_of_a_subject_are_kept_in_its_file(tmp_path) -> None:
    subject = load_subject("noa")
    hair = cut(crop=1.0, beard=0.5)
    assert subject.head_codes is not None
    hairy = replace(subject, codes=replace(subject.codes, hair=hair), head_codes=replace(subject.head_codes, hair=hair))
    hairy.save(tmp_path / "a.safetensors")
    again = load_subject(tmp_path / "a.safetensors")
    assert again.head_codes is not None
    np.testing.assert_array_equal(again.codes.hair, hair)
    np.testing.assert_array_equal(again.head_codes.hair, hair)
    assert load_subject("noa").codes.hair.size == 0
