"""A texture: every texel where it belongs, in files that others read."""

from __future__ import annotations

import json

import numpy as np
import pytest
import trimesh

import gazenerf.export.appearance.colours
from gazenerf.errors import UserError
from gazenerf.export import MeshOptions, extract_part, mesh_subject
from gazenerf.export.appearance.colours import blend_colours, part_pictures, sample
from gazenerf.export.appearance.texture import bake_texture, dilate, face_blocks, texels, unwrap
from gazenerf.export.appearance.textured_views import render_glb, texture_psnr
from gazenerf.export.formats.files import textured_node
from gazenerf.export.formats.gltf import glb
from gazenerf.export.mesh.rays import cast_rays
from gazenerf.geometry import Camera
from gazenerf.heads.analytic import AnalyticField, AnalyticHead


@pytest.fixture(autouse=True)
def small_pictures(monkeypatch):
    monkeypatch.setattr(gazenerf.export.appearance.colours, "PICTURE", 256)


@pytest.fixture(scope="module")
def bound():
    return AnalyticField(sharpness=0.2)


@pytest.fixture(scope="module")
def face(bound):
    return extract_part(bound, "face", MeshOptions(resolution=40, threshold=100.0, colours=False, smoothing=0)).mesh


@pytest.fixture(scope="module")
def textured(bound, face):
    return bake_texture(face, part_pictures(bound, "face"), 1024)


def wave(points):
    """The colour of the analytic face."""
    return 0.5 + 0.25 * np.sin(5.0 * points) * np.cos(3.0 * np.roll(points, 1, axis=-1))


def test_charts_do_not_overlap_and_keep_the_surface(face):
    cut, uv, charts = unwrap(face, 1024)
    assert charts >= 1 and uv.min() >= 0.0 and uv.max() <= 1.0
    assert cut.area == pytest.approx(face.area, rel=1e-6) and len(cut.faces) == len(face.faces)
    row, column, owner, weights = texels(uv, np.asarray(cut.faces), 1024)
    assert np.allclose(weights.sum(axis=1), 1.0, atol=1e-5)
    places = row * 1024 + column
    doubled = len(places) - len(np.unique(places))
    assert doubled < 1e-3 * len(places)
    centre = np.einsum("nk,nkc->nc", weights, uv[np.asarray(cut.faces)[owner]]) * 1024
    assert np.abs(centre - np.stack([column + 0.5, row + 0.5], axis=1)).max() < 1e-2


def test_unwrapping_in_blocks_keeps_every_face_as_unwrapping_at_once_does(face):
    blocks = face_blocks(face, 500)
    assert len(blocks) > 4 and max(map(len, blocks)) <= 500
    assert np.array_equal(np.sort(np.concatenate(blocks)), np.arange(len(face.faces)))
    covered = []
    for block in (500, len(face.faces)):
        cut, uv, _ = unwrap(face, 1024, block)
        assert np.array_equal(cut.triangles, face.triangles)
        assert np.array_equal(cut.vertex_normals[cut.faces], face.vertex_normals[face.faces])
        places = np.ravel_multi_index(texels(uv, np.asarray(cut.faces), 1024)[:2], (1024, 1024))
        assert len(places) - len(np.unique(places)) < 1e-3 * len(places)
        covered.append(len(places))
    assert covered[0] > 0.8 * covered[1]


def slow_view(picture, mesh, points, normals):
    """Sums of one view, (N, 3) and (N,): every point's ray is cast, as the definition says."""
    offset = points - picture.camera.position
    distance = np.linalg.norm(offset, axis=1)
    facing = -(offset * normals).sum(axis=1) / distance
    hit = cast_rays(mesh, np.broadcast_to(picture.camera.position, points.shape), offset / distance[:, None])
    pixels = picture.camera.project(points)[0]
    x, y = (pixels - 0.5).astype(np.float32).T
    height, width = picture.depth.shape
    column, row = (pixels * [width / picture.camera.width, height / picture.camera.height]).astype(int).T
    inside = ((pixels >= 0) & (pixels < [picture.camera.width, picture.camera.height])).all(axis=1)
    depth = picture.depth[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)]
    agrees = np.isnan(depth) | (np.abs(depth - distance) < 0.15)
    solid = np.clip(2.0 * sample(picture.opacity, x, y) - 1.0, 0.0, 1.0)
    share = facing**3 * solid * ((facing > 0.15) & (np.abs(hit - distance) < 0.02) & inside & agrees)
    return share[:, None] * sample(picture.image, x, y), share


def test_casting_rays_last_changes_no_colour(bound, face):
    pictures = part_pictures(bound, "face", ((0.0, 0.0), (60.0, 10.0), (-150.0, 5.0)))
    points, normals = np.asarray(face.vertices), np.asarray(face.vertex_normals)
    sums = [slow_view(picture, face, points, normals) for picture in pictures]
    weight = sum(share for _, share in sums)
    colours, seen = blend_colours(pictures, face, points, normals)
    assert 0.3 < seen.mean() < 1.0 and np.array_equal(seen, weight > 1e-6)
    expected = 255.0 * sum(total for total, _ in sums)[seen] / weight[seen, None]
    assert np.abs(colours[seen] - expected).max() < 0.51


def test_texels_of_a_known_triangle():
    uv = np.array([[0.0, 0.0], [0.5, 0.0], [0.0, 0.5]], np.float32)
    row, column, _, weights = texels(uv, np.array([[0, 1, 2]]), 8)
    assert set(zip(row.tolist(), column.tolist(), strict=True)) == {(r, c) for r in range(4) for c in range(4 - r)}
    first = int(np.flatnonzero((row == 0) & (column == 0))[0])
    assert np.allclose(weights[first], [0.75, 0.125, 0.125])


def test_gaps_take_the_nearest_colour():
    image, inside = np.zeros((5, 9, 3), np.uint8), np.zeros((5, 9), bool)
    image[2, 1], image[2, 7] = 50, 200
    inside[2, 1] = inside[2, 7] = True
    filled = dilate(image, inside)
    assert (filled[:, :4] == 50).all() and (filled[:, 5:] == 200).all()
    assert (dilate(image, np.zeros((5, 9), bool)) == image).all()


def test_the_texture_holds_the_colour_of_its_surface(textured):
    mesh, uv = textured.mesh, textured.uv
    centres = np.asarray(mesh.triangles_center)
    at = (1024 * uv[np.asarray(mesh.faces)].mean(axis=1)).astype(int)
    front = centres[:, 2] > 0.3
    difference = np.abs(textured.image[at[:, 1], at[:, 0]] / 255.0 - wave(centres))[front]
    assert difference.mean() < 0.01 and np.percentile(difference, 99) < 0.05
    assert textured.seen > 0.9 and 0.3 < textured.covered < 1.0


def test_files_with_textures_reload(bound, tmp_path, monkeypatch):
    monkeypatch.setattr("gazenerf.export.pipeline.texture_psnr", lambda *_: {"psnr_db": [30.0]})
    bound = AnalyticField(sharpness=0.2)
    settings: dict = {
        "resolution": 32,
        "threshold": 100.0,
        "smoothing": 0,
        "texture": 1024,
        "formats": ("glb", "obj", "ply"),
    }
    mesh_subject(AnalyticHead(lambda gaze: bound), tmp_path, MeshOptions(parts=("face",), **settings))
    written = sorted(path.name for path in tmp_path.iterdir())
    assert written == ["face.glb", "face.json", "face.mtl", "face.obj", "face.ply", "face.png"]
    pictures = []
    for kind in ("glb", "obj"):
        mesh = trimesh.load(tmp_path / f"face.{kind}", force="mesh", process=False)
        assert np.allclose(np.abs(mesh.bounds), 0.1 * bound.face.radii, atol=1e-3)
        material = mesh.visual.material
        picture = np.asarray(material.baseColorTexture if kind == "glb" else material.image)[..., :3]
        pictures.append(picture)
        uv = np.asarray(mesh.visual.uv)  # trimesh has v up
        front = np.asarray(mesh.vertices)[:, 2] > 0.03
        at = np.clip((1024 * np.stack([uv[:, 0], 1.0 - uv[:, 1]], axis=1)).astype(int), 0, 1023)
        colour = picture[at[:, 1], at[:, 0]] / 255.0
        assert np.abs(colour - wave(np.asarray(mesh.vertices) * 10.0))[front].mean() < 0.02
        if kind == "glb":
            assert material.metallicFactor == 0.0
    assert np.array_equal(*pictures)
    about = json.loads((tmp_path / "face.json").read_text())
    assert about["texture"]["size"] == 1024 and about["texture_against_the_field"] == {"psnr_db": [30.0]}
    assert trimesh.load(tmp_path / "face.ply", process=False).visual.kind == "vertex"


def test_the_file_rendered_back_shows_what_the_field_shows(bound, textured):
    data = glb(textured_node("face", textured, bound.metres_per_unit))
    try:
        render_glb(data, [Camera.neutral(16)], 10.0)
    except UserError as error:
        pytest.skip(str(error))
    measured = texture_psnr(bound, "face", data)
    assert min(measured["psnr_db"]) > 38.0


def test_without_opengl_the_comparison_says_why(bound, textured, monkeypatch):
    def fail(*_):
        raise UserError("no context; install libegl1")

    monkeypatch.setattr("gazenerf.export.appearance.textured_views.render_glb", fail)
    assert texture_psnr(bound, "face", b"") == {"not_measured": "no context; install libegl1"}


def test_other_sizes_are_refused(bound):
    with pytest.raises(UserError, match="1024, 2048 or 4096"):
        extract_part(bound, "face", MeshOptions(texture=1000))


def test_a_texture_that_cannot_fit_says_how_large_it_would_be(bound, monkeypatch):
    monkeypatch.setattr("gazenerf.export.appearance.texture.available_memory", lambda: 2**30)
    with pytest.raises(UserError, match=r"1\.6 GiB, 1\.0 GiB are free; give a smaller --texture"):
        extract_part(bound, "face", MeshOptions(texture=4096))


def test_what_is_cut_from_the_mesh_but_hides_it_in_a_picture_gives_no_colour(bound):
    both = extract_part(bound, "eyes", MeshOptions(resolution=64, threshold=100.0, colours=False)).mesh
    left = both.split()
    left = max(left, key=lambda piece: piece.centroid[0])
    right_side = part_pictures(bound, "eyes", ((-90.0, 0.0),))
    inward = np.asarray(left.vertices)[np.asarray(left.vertex_normals)[:, 0] < -0.9]
    colours, seen = blend_colours(right_side, left, inward, np.tile([-1.0, 0.0, 0.0], (len(inward), 1)))
    assert not seen.any(), "the other eye is in the way, though only in the picture"
    colours, seen = blend_colours(part_pictures(bound, "eyes"), left, inward, np.tile([-0.7, 0, 0.7], (len(inward), 1)))
    assert seen.all() and colours.mean() > 200
