"""Hair that a mask and colours tell of is found again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gazenerf.data.rasterizer import Rasterizer
from gazenerf.head_model import FACE, HAIR
from gazenerf.head_model.ray_scenes import ray_scene, tensor
from gazenerf.photographs.appearance import above_chin
from gazenerf.photographs.fit import Photograph, fit_photographs
from gazenerf.photographs.hair_fit import HAIR_LABEL, fit_hair
from gazenerf.photographs.landmarks import FaceLandmarks

SIZE = 256


def photographed(model, rendered, **amounts: float):
    """A person with a cut: picture, mask, where hair is seen, and landmarks."""
    item = rendered[0]
    hair = np.array([amounts.get(name, 0.0) for name in model.hair_names], np.float32)
    codes = replace(item.codes, hair=hair)
    mesh, camera = model.mesh(codes, item.gaze), item.camera.resized(SIZE, SIZE)
    with Rasterizer((SIZE, SIZE), 2) as rasterizer:
        raster = rasterizer.render_lit(mesh, codes.illumination, camera)
    image = np.where(raster.parts[..., None] > 0, raster.image, 150).astype(np.uint8)
    return codes, camera, image, raster.parts > 0, hair_seen(model, codes, item.gaze, camera)


def hair_seen(model, codes, gaze, camera) -> np.ndarray:
    """(H, W) bool: where hair is in front."""
    mesh = model.mesh(codes, gaze)
    origins, directions = camera.rays()
    rays = np.concatenate([np.broadcast_to(origins, directions.shape), directions], axis=-1)
    return (
        ray_scene(mesh.vertices, mesh.part_faces(FACE), mesh.part_faces(HAIR))
        .cast_rays(tensor(rays))["geometry_ids"]
        .numpy()
        == 1
    )


def found(model, rendered, **amounts: float):
    codes, camera, image, mask, true = photographed(model, rendered, **amounts)
    points, _ = camera.project(rendered[0].mesh.vertices[model.landmark_vertices].astype(float))
    bare = replace(codes, hair=np.zeros(0, np.float32))
    hair = fit_hair(model, bare, rendered[0].gaze, camera, image, FaceLandmarks(points), mask)
    return hair, codes, camera, true


@pytest.mark.parametrize("amounts", [{"crop": 0.8, "round": 0.9}, {"crop": 0.4, "bob": 1.0, "fringe": 1.0}])
def test_a_fitted_cut_covers_what_the_photographs_hair_covers(model, rendered, amounts) -> None:
    hair, codes, camera, true = found(model, rendered, **amounts)
    drawn = hair_seen(model, replace(codes, hair=hair), rendered[0].gaze, camera)
    where = above_chin(rendered[0].mesh, camera)
    overlap = (drawn & true & where).sum() / ((drawn | true) & where).sum()
    assert overlap > 0.85


def test_without_hair_or_without_a_mask_none_is_fitted(model, rendered) -> None:
    codes, camera, image, mask, _ = photographed(model, rendered)
    points, _ = camera.project(rendered[0].mesh.vertices[model.landmark_vertices].astype(float))
    marks, gaze = FaceLandmarks(points), rendered[0].gaze
    hair = fit_hair(model, codes, gaze, camera, image, marks, mask)
    assert not hair.any() or hair.max() <= 0.8
    assert fit_hair(model, codes, gaze, camera, image, marks, None).size == 0


def test_a_face_parsers_labels_tell_of_hair_without_a_mask(model, rendered) -> None:
    codes, camera, image, mask, true = photographed(model, rendered, crop=0.8, round=0.9)
    labels = np.where(true, HAIR_LABEL, np.where(mask, 1, 0)).astype(np.uint8)
    points, _ = camera.project(rendered[0].mesh.vertices[model.landmark_vertices].astype(float))
    bare = replace(codes, hair=np.zeros(0, np.float32))
    hair = fit_hair(model, bare, rendered[0].gaze, camera, image, FaceLandmarks(points), None, labels)
    drawn = hair_seen(model, replace(codes, hair=hair), rendered[0].gaze, camera)
    assert (drawn & true).sum() / (drawn | true).sum() > 0.85


def test_a_fit_has_hair_only_where_it_is_asked_for(model, rendered, landmarks, monkeypatch) -> None:
    monkeypatch.setattr("gazenerf.photographs.shape_fit.STEPS", 15)
    monkeypatch.setattr("gazenerf.photographs.shape_fit.MORE_STEPS", 5)
    given = np.full(len(model.hair_names), 0.5, np.float32)
    monkeypatch.setattr("gazenerf.photographs.fit.fit_hair", lambda *_: given)
    photograph = Photograph("a.png", rendered[0].image, landmarks[0])
    plain = fit_photographs([photograph], model)[0]
    assert plain.subject.codes.hair.size == 0 and not len(plain.seen.mesh.part_faces(HAIR))
    hairy = fit_photographs([photograph], model, hair=True)[0]
    np.testing.assert_array_equal(hairy.subject.codes.hair, given)
    assert hairy.subject.head_codes is not None
    np.testing.assert_array_equal(hairy.subject.head_codes.hair, given)
    assert (
        len(hairy.seen.mesh.part_faces(HAIR))
        and (hairy.seen.raster.parts > 0).sum() > (plain.seen.raster.parts > 0).sum()
    )


def test_a_beard_is_fitted_where_the_chin_has_one_and_not_for_a_collar_below_it(model, rendered) -> None:
    index = model.hair_names.index("beard")
    assert found(model, rendered, crop=0.8, beard=1.0)[0][index] > 0.2
    codes, camera, image, mask, true = photographed(model, rendered, crop=0.8)
    collar = mask & ~above_chin(rendered[0].mesh, camera)
    assert collar.sum() > 200
    image[collar] = np.median(image[true], axis=0)
    points, _ = camera.project(rendered[0].mesh.vertices[model.landmark_vertices].astype(float))
    bare = replace(codes, hair=np.zeros(0, np.float32))
    assert fit_hair(model, bare, rendered[0].gaze, camera, image, FaceLandmarks(points), mask)[index] == 0.0
