"""The rig: spheres fitted to the eyes, nodes that turn, a file that others read."""

from __future__ import annotations

import json

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from gazenerf.errors import UserError
from gazenerf.export import MeshOptions, extract_part, mesh_subject
from gazenerf.export.appearance.eyeball_texture import (
    _first_hit,
    depth_before,
    directions_of,
    eyeball_mesh,
    textured_eyeball,
)
from gazenerf.export.formats.gltf import glb
from gazenerf.export.formats.nodes import Animation, Node
from gazenerf.export.mesh.sphere_fit import fit_eyeballs, fit_sphere
from gazenerf.export.scenes.rig import SWEEP, quaternion, rig
from gazenerf.geometry import Camera, Gaze
from gazenerf.heads.analytic import AnalyticField, AnalyticHead


def bind(gaze: Gaze) -> AnalyticField:
    return AnalyticField(gaze, sharpness=0.2)


HEAD = AnalyticHead(bind)


def parsed(data: bytes) -> tuple[dict, bytes]:
    """The JSON and binary chunks of a GLB."""
    assert data[:4] == b"glTF" and int.from_bytes(data[8:12], "little") == len(data)
    size = int.from_bytes(data[12:16], "little")
    return json.loads(data[20 : 20 + size]), data[28 + size :]


@pytest.fixture(scope="module")
def parts() -> dict[str, trimesh.Trimesh]:
    bound = bind(Gaze())
    return {
        "face": extract_part(bound, "face", MeshOptions(resolution=32, threshold=100.0, colours=False)).mesh,
        "eyes": extract_part(bound, "eyes", MeshOptions(resolution=96, threshold=100.0, colours=False)).mesh,
    }


def test_sphere_fit_survives_noise_and_outliers():
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(600, 3))
    directions[:, 2] = np.abs(directions[:, 2])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    centre = np.array([0.3, 0.1, 0.7])
    points = centre + 0.12 * directions + rng.normal(scale=0.0005, size=(600, 3))
    points[:90] += rng.uniform(0.02, 0.08, (90, 3))
    eye = fit_sphere(points)
    assert np.abs(eye.centre - centre).max() * 100 < 0.1  # mm
    assert abs(eye.radius - 0.12) * 100 < 0.1


def test_a_flat_or_tiny_eye_is_refused():
    flat = np.random.default_rng(0).uniform(size=(100, 3)) * [1, 1, 1e-6]
    with pytest.raises(UserError, match="does not look like spheres"):
        fit_sphere(flat)
    with pytest.raises(UserError, match="too few"):
        fit_sphere(flat[:5])


def test_fitted_eyes_are_the_analytic_spheres(parts):
    for eye, truth in zip(fit_eyeballs(parts["eyes"]), bind(Gaze()).eyes, strict=True):
        assert np.abs(eye.centre - truth.centre).max() * 100 < 0.1
        assert abs(eye.radius - truth.radii[0]) * 100 < 0.1
        assert eye.covered > 0.95


def test_eyeball_is_a_closed_sphere_whose_texture_has_one_place_for_each_point():
    mesh, uv = eyeball_mesh(0.12)
    assert np.allclose(np.linalg.norm(mesh.vertices, axis=1), 0.12)
    disc = (uv - 0.5) * [2.0, -2.0]
    assert np.abs(directions_of(disc) * 0.12 - mesh.vertices).max() < 1e-6
    a, b = np.diff(uv[mesh.faces], axis=1).transpose(1, 2, 0)
    assert (a[0] * b[1] - a[1] * b[0] < 0).all()
    mesh.merge_vertices(merge_norm=True)
    assert mesh.is_watertight and mesh.volume == pytest.approx(4 / 3 * np.pi * 0.12**3, rel=0.01)


@pytest.mark.parametrize("gazes", [[(0.0, 0.0)], [(0.0, 25.0), (15.0, 0.0)]])
def test_eyeball_has_its_iris_at_the_pole_whatever_gazes_coloured_it(parts, gazes):
    eye = fit_eyeballs(parts["eyes"])[0]
    ball = textured_eyeball(HEAD, eye, gazes)
    place = np.minimum((ball.uv * len(ball.image)).astype(int), len(ball.image) - 1)
    colours = ball.image[place[:, 1], place[:, 0], 0].astype(float)
    look = np.asarray(ball.mesh.vertices)[:, 2] / eye.radius
    assert colours[look > 0.95].mean() < 60 < 180 < colours[(look < 0.7) & (look > 0.3)].mean()
    assert colours[look < -0.5].mean() > 180
    assert 0.05 < ball.seen < 0.9


def test_the_depth_before_an_eyeball_is_that_of_the_whole_picture(parts):
    eye, bound = fit_eyeballs(parts["eyes"])[0], HEAD.at(Gaze.from_degrees(5.0, -10.0))
    camera = Camera.neutral(96)
    ball = _first_hit(*camera.rays(), eye)
    depth, whole = depth_before(bound, camera, ball), bound.render_geometry(camera).depth
    behind = np.isfinite(ball)
    assert 20 < behind.sum() < 0.2 * behind.size and np.isfinite(whole[behind]).all()
    assert np.allclose(depth[behind], whole[behind], atol=1e-5)
    assert np.isnan(depth).mean() > 0.9
    nowhere = depth_before(bound, camera, np.full_like(ball, np.nan))
    assert np.isnan(nowhere).all()


def test_rig_turns_each_eye_about_its_centre(parts, tmp_path):
    gaze = Gaze.from_degrees(10.0, 20.0)
    scene = rig(HEAD, gaze, parts["face"], parts["eyes"])
    data, facts = glb(scene.root, scene.clips), scene.facts
    tree, binary = parsed(data)
    nodes = {node["name"]: node for node in tree["nodes"]}
    assert set(nodes) == {"head", "face", "eye_left", "eye_right"}
    assert nodes["head"]["children"] and "mesh" not in nodes["head"]
    assert np.allclose(nodes["eye_left"]["translation"], [0.032, 0.01, 0.08], atol=1e-4)
    forward = Rotation.from_quat(nodes["eye_left"]["rotation"]).apply([0.0, 0.0, 1.0])
    assert np.allclose(forward, gaze.vector(), atol=1e-6)
    clip = tree["animations"][0]
    output = tree["accessors"][clip["samplers"][0]["output"]]
    view = tree["bufferViews"][output["bufferView"]]
    turns = np.frombuffer(binary, "<f4", 4 * output["count"], view["byteOffset"]).reshape(-1, 4)
    assert np.allclose(turns, [quaternion(Gaze.from_degrees(*key)) for key in SWEEP], atol=1e-6)
    assert {channel["target"]["node"] for channel in clip["channels"]} == {
        tree["nodes"].index(nodes["eye_left"]),
        tree["nodes"].index(nodes["eye_right"]),
    }
    assert facts["eye_left"]["radius_mm"] == pytest.approx(12.0, abs=0.1)
    path = tmp_path / "rig.glb"
    path.write_bytes(data)
    loaded = trimesh.load(path)
    assert np.allclose(loaded.bounds[:, 1], parts["face"].bounds[:, 1] * 0.1, atol=1e-5)
    for name in ("eye_left", "eye_right"):
        assert loaded.geometry[name].visual.material.baseColorTexture.size == (512, 512)


def test_every_accessor_lies_in_the_buffer_on_its_boundary(parts):
    tree, binary = parsed(glb(Node("head", parts["face"])))
    sizes = {5126: 4, 5125: 4, 5123: 2}
    widths = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}
    assert tree["buffers"][0]["byteLength"] == len(binary)
    for accessor in tree["accessors"]:
        view = tree["bufferViews"][accessor["bufferView"]]
        needed = accessor["count"] * sizes[accessor["componentType"]] * widths[accessor["type"]]
        assert view["byteLength"] == needed
        assert view["byteOffset"] % 4 == 0 and view["byteOffset"] + needed <= len(binary)


def test_a_clip_must_name_nodes_that_exist(parts):
    clip = Animation("turn", np.arange(2.0), {"nose": np.tile([0.0, 0.0, 0.0, 1.0], (2, 1))})
    with pytest.raises(ValueError, match="nose"):
        glb(Node("head", parts["face"]), (clip,))


def test_rig_is_written_with_the_meshes_or_refused(tmp_path):
    with pytest.raises(UserError, match="--parts face eyes"):
        mesh_subject(HEAD, tmp_path / "a", MeshOptions(parts=("eyes",), rig=True))
    options = MeshOptions(
        resolution=40, threshold=100.0, formats=("ply",), colours=False, rig=True, page=True, clip=False
    )
    made = mesh_subject(HEAD, tmp_path / "b", options)
    assert made.scenes["rig"].facts == json.loads((tmp_path / "b" / "rig.json").read_text())
    written = sorted(path.name for path in (tmp_path / "b").iterdir())
    assert written == ["eyes.json", "eyes.ply", "face.json", "face.ply", "index.html", "rig.glb", "rig.json"]
    tree, _ = parsed((tmp_path / "b" / "rig.glb").read_bytes())
    assert "animations" not in tree, "without the clip nothing turns the eyes back"
    assert len(tree["meshes"][0]["primitives"][0]["targets"]) == 8
    assert "<title>analytic</title>" in (tmp_path / "b" / "index.html").read_text(encoding="utf-8")
    about = json.loads((tmp_path / "b" / "rig.json").read_text())
    assert about["units"] == "metres" and about["eye_right"]["centre_metres"][0] < 0
    with pytest.raises(UserError, match="--overwrite"):
        mesh_subject(HEAD, tmp_path / "b", options)
