"""Detail of a person's skin lies on the surface, whatever draws the picture."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch

from gazenerf.checkpoints import load_field
from gazenerf.errors import UserError
from gazenerf.field.detail import EXTENT, SurfaceDetail, detail_coordinates
from gazenerf.geometry import Camera, Gaze
from gazenerf.head_model import load_head_model
from gazenerf.head_model.interface import FACE
from gazenerf.heads import Head
from gazenerf.heads.cutouts import render_cut_out
from gazenerf.heads.surface_detail import surface_places
from gazenerf.personal_weights import PersonalWeights
from gazenerf.subjects import load_subject
from gazenerf.training.texture_detail import without_detail

SIZE, GAZE = 128, Gaze(0.1, -0.2)
CAMERAS = [Camera.orbit(0.0, size=SIZE), Camera.orbit(0.5, 0.1, size=SIZE)]


def detailed(name: str) -> tuple[Head, Head]:
    """A head without and with waves of detail."""
    field, subject = without_detail(load_field(name)), load_subject("noa")
    field.weights_hash = "0123456789abcdef"
    rows, columns = np.mgrid[0:54, 0:72].astype(np.float32)
    values = 0.05 * np.stack([np.sin(0.6 * columns), np.sin(0.5 * rows), np.cos(0.4 * (rows + columns))])
    changes = {"detail.values": values.astype(np.float16)}
    with_it = replace(subject, personal=PersonalWeights(field.weights_hash, changes))
    return Head(field, subject), Head(field, with_it)


@pytest.fixture(scope="module", params=["small", "portrait-sdf"])
def heads(request) -> tuple[Head, Head]:
    return detailed(request.param)


def expected(head: Head, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """The slow way: detail where each pixel of the picture meets the surface, and which pixels meet it facing them."""
    detail = head.field.detail
    assert detail is not None
    view = head.at(GAZE).render_geometry(camera, normals=True)
    assert view.normals is not None
    points = torch.from_numpy(np.nan_to_num(view.points()).reshape(-1, 3).astype(np.float32))
    with head.quickly():
        places = surface_places(head.at(GAZE), points).reshape(1, SIZE, SIZE, 3)
        added = detail(places)[0].permute(1, 2, 0).numpy()
    facing = -(view.normals * camera.rays()[1]).sum(-1)
    return added, (view.opacity > 0.99) & (facing > 0.6)


@pytest.mark.parametrize("camera", CAMERAS, ids=["front", "aside"])
def test_what_is_added_is_the_detail_where_each_pixel_lies(heads: tuple[Head, Head], camera: Camera) -> None:
    before, after = (head.at(GAZE).render(camera, ("head", "eyes")) for head in heads)
    added = after.image - before.image
    wanted, inside = expected(heads[1], camera)
    assert inside.sum() > 2500 and np.abs(wanted[inside]).mean() > 0.02
    assert np.median(np.abs(added - wanted)[inside]) < 0.003
    assert np.quantile(np.abs(added - wanted)[inside], 0.95) < 0.02
    opacity = before.geometry["head"].opacity
    near = cv2.dilate(cv2.resize(opacity, (SIZE, SIZE)), np.ones((17, 17), np.uint8)) > 0.0
    assert near.any() and not near.all() and not added[~near].any()
    np.testing.assert_array_equal(after.images["eyes"], before.images["eyes"])
    np.testing.assert_array_equal(after.geometry["head"].depth, before.geometry["head"].depth)


def test_every_path_adds_it(heads: tuple[Head, Head]) -> None:
    head = heads[1]
    alone = [head.at(GAZE).render(camera).image for camera in CAMERAS]
    together = head.frames.render([(head.at(GAZE), camera) for camera in CAMERAS])
    for one, other in zip(alone, together, strict=True):
        np.testing.assert_allclose(other.image, one, atol=2e-3)
    cut = render_cut_out(head.at(GAZE), CAMERAS[1]).cutouts["head"]
    solid = cut[..., 3] > 0.999
    np.testing.assert_allclose(cut[solid][:, :3], alone[1][solid], atol=2e-3)


def test_lids_keep_their_places_while_they_move(heads: tuple[Head, Head]) -> None:
    """Upper lids of a head that looks down lie where they do on the template while it looks up."""
    head = heads[0]
    if head.field.config.features_at != "template":
        pytest.skip("features of this field lie still")
    model, gazes = load_head_model(), (Gaze(np.deg2rad(20.0), 0.0), Gaze(np.deg2rad(-20.0), 0.0))
    meshes = [model.mesh(head.subject.codes, gaze) for gaze in gazes]
    skin = np.unique(meshes[0].part_faces(FACE))
    moved = np.linalg.norm(meshes[0].vertices[skin] - meshes[1].vertices[skin], axis=1)
    lids = skin[moved > 0.03]
    assert len(lids) > 500
    points = [torch.from_numpy(mesh.vertices[lids].astype(np.float32)) for mesh in meshes]
    with head.quickly():
        up, down = (surface_places(head.at(gaze), there).numpy() for gaze, there in zip(gazes, points, strict=True))
        as_before = surface_places(head.at(gazes[0]), points[1]).numpy()
    still = np.median(np.linalg.norm(up - down, axis=1))
    assert still < 0.5 * np.median(moved[moved > 0.03])
    assert still < 0.7 * np.median(np.linalg.norm(up - as_before, axis=1))


def test_detail_is_looked_up_by_direction() -> None:
    values = torch.zeros(3, 4, 8)
    values[0, 1, 6] = 5.0
    detail = SurfaceDetail(values)
    azimuth, elevation = np.radians(EXTENT[0] * (6.5 / 4 - 1.0)), np.radians(EXTENT[1] * (1.5 / 2 - 1.0))
    ray = [np.sin(azimuth) * np.cos(elevation), np.sin(elevation), np.cos(azimuth) * np.cos(elevation)]
    places = torch.tensor(np.array([[[ray, np.negative(ray)]]]) * 0.8, dtype=torch.float32)
    torch.testing.assert_close(detail_coordinates(places)[0, 0, 0], torch.tensor([6.5 / 4 - 1.0, 1.5 / 2 - 1.0]))
    torch.testing.assert_close(detail(places)[0, 0, 0], torch.tensor([5.0, 0.0]), atol=1e-4, rtol=0.0)


def test_detail_of_another_kind_is_one_line() -> None:
    field, subject = load_field("small"), load_subject("noa")
    bad = PersonalWeights(field.weights_hash, {"detail.values": np.zeros((4, 5, 6), np.float16)})
    with pytest.raises(UserError, match=r"detail.values has the shape \(4, 5, 6\)"):
        Head(field, replace(subject, personal=bad))
