"""Gaze sequences: lids follow a density that moves, nothing else does, and the file holds both motions."""

from __future__ import annotations

import json

import numpy as np
import pytest
import torch
import trimesh

from gazenerf.errors import UserError
from gazenerf.export import MeshOptions, extract_part, mesh_subject
from gazenerf.export.formats.gltf import glb
from gazenerf.export.scenes.rig import quaternion, rig
from gazenerf.export.scenes.sequence import FPS, STEPS, face_crossings, face_morphs, sequence_scene
from gazenerf.geometry import Gaze
from gazenerf.heads.analytic import AnalyticField, AnalyticHead

LEVEL = 100.0
GAZES = [Gaze.from_degrees(*angles) for angles in ((0, 0), (0, 20), (10, 0))]


class Lids(AnalyticField):
    """A face that swells about the eyes by 2 mm at 10 degrees of pitch, and far from them too."""

    def __init__(self, gaze):
        super().__init__(gaze, sharpness=0.2)

    def density(self, points, part="head"):
        if part != "face":
            return super().density(points, part)
        amount = 0.02 * self.gaze.pitch / np.deg2rad(10.0)
        return super().density(points / (1.0 + amount), part)


HEAD = AnalyticHead(Lids)


@pytest.fixture(scope="module")
def parts():
    bound = Lids(Gaze())
    return {
        part: extract_part(bound, part, MeshOptions(resolution=64, threshold=LEVEL, colours=False))
        for part in ("face", "eyes")
    }


@pytest.fixture(scope="module")
def scene(parts):
    return rig(HEAD, Gaze(), parts["face"].mesh, parts["eyes"].mesh)


def test_looking_near_first_finds_what_looking_everywhere_finds(parts):
    face, asked = parts["face"].mesh, []

    class Counted(Lids):
        def density(self, points, part="head"):
            asked.append(len(points))
            return super().density(points, part)

    bound = Counted(Gaze.from_degrees(5.0, 0.0))
    points, normals = np.asarray(face.vertices), np.asarray(face.vertex_normals)
    points = points + np.linspace(-0.06, 0.06, len(points))[:, None] * normals
    fast = face_crossings(bound, points, normals, LEVEL)
    few = sum(asked)
    slow = face_crossings(bound, points, normals, LEVEL, (STEPS // 2,))
    assert few < 0.8 * (sum(asked) - few) and sum(asked) - few == STEPS * len(points)
    assert 0.01 < np.isnan(slow).mean() < 0.7
    np.testing.assert_allclose(fast, slow, atol=1e-6)


@pytest.fixture(scope="module")
def moved(scene):
    """The rig's face with its vertices on the true surface, and its morphs."""
    face = extract_part(Lids(Gaze()), "face", MeshOptions(resolution=96, threshold=LEVEL, colours=False)).mesh
    return face, *face_morphs(HEAD, Gaze(), GAZES, face, scene.eyeballs, LEVEL)


def test_the_face_goes_to_the_surface_of_each_gaze_about_the_eyes_and_nowhere_else(moved, scene):
    face, morphs, followed = moved
    assert not morphs[0].offsets.any() and not morphs[1].offsets.any()
    offsets = morphs[2].offsets / Lids(Gaze()).metres_per_unit
    away = np.min([np.linalg.norm(face.vertices - eye.centre, axis=1) / eye.radius for eye in scene.eyeballs], axis=0)
    assert not offsets[away > 3.0].any()
    close = np.asarray(face.vertices)[away < 2.0]
    turned = Lids(GAZES[2])
    before = turned.density(torch.from_numpy(close).float(), "face").numpy()
    after = turned.density(torch.from_numpy(close + offsets[away < 2.0]).float(), "face").numpy()
    assert np.median(np.abs(after - LEVEL)) < 0.05 * np.median(np.abs(before - LEVEL))
    assert followed[2].before_mm > 1.0 and followed[2].after_mm < 0.05


def test_vertices_doubled_along_seams_stay_together(moved, scene):
    face = moved[0]
    cut = trimesh.Trimesh(
        face.vertices[face.faces].reshape(-1, 3),
        np.arange(3 * len(face.faces)).reshape(-1, 3),
        vertex_normals=face.vertex_normals[face.faces].reshape(-1, 3),
        process=False,
    )
    morphs, _ = face_morphs(HEAD, Gaze(), GAZES[2:], cut, scene.eyeballs, LEVEL)
    assert np.allclose(morphs[0].offsets, moved[1][2].offsets[face.faces].reshape(-1, 3), atol=1e-9)


def test_the_file_holds_turning_eyes_and_a_following_face(parts, scene):
    made = sequence_scene(HEAD, Gaze(), scene, GAZES, parts["face"].mesh, LEVEL)
    data = glb(made.root, made.clips)
    size = int.from_bytes(data[12:16], "little")
    tree, binary = json.loads(data[20 : 20 + size]), data[28 + size :]
    nodes = {node["name"]: node for node in tree["nodes"]}
    face = tree["meshes"][nodes["face"]["mesh"]]
    targets = face["primitives"][0]["targets"]
    assert len(targets) == len(GAZES) and len(face["extras"]["targetNames"]) == len(GAZES)
    clip = tree["animations"][0]
    channels = {
        (tree["nodes"][channel["target"]["node"]]["name"], channel["target"]["path"]): clip["samplers"][
            channel["sampler"]
        ]
        for channel in clip["channels"]
    }
    assert set(channels) == {("eye_left", "rotation"), ("eye_right", "rotation"), ("face", "weights")}

    def values(index, width):
        view = tree["bufferViews"][tree["accessors"][index]["bufferView"]]
        return np.frombuffer(binary, "<f4", view["byteLength"] // 4, view["byteOffset"]).reshape(-1, width)

    assert np.allclose(values(channels["face", "weights"]["output"], 3), np.eye(3))
    turns = values(channels["eye_left", "rotation"]["output"], 4)
    assert np.allclose(turns, [quaternion(gaze) for gaze in GAZES], atol=1e-6)
    assert np.allclose(values(channels["face", "weights"]["input"], 1)[:, 0], np.arange(3) / FPS)
    entry = tree["accessors"][targets[2]["POSITION"]]
    assert entry["sparse"]["indices"]["byteOffset"] == entry["sparse"]["values"]["byteOffset"] == 0
    rows = tree["bufferViews"][entry["sparse"]["indices"]["bufferView"]]
    index = np.frombuffer(binary, "<u4", entry["sparse"]["count"], rows["byteOffset"])
    offsets = tree["bufferViews"][entry["sparse"]["values"]["bufferView"]]
    stored = np.frombuffer(binary, "<f4", 3 * len(index), offsets["byteOffset"]).reshape(-1, 3)
    morph = next(node for node in made.root.children if node.name == "face").morphs[2]
    full = np.zeros_like(morph.offsets)
    full[index] = stored
    assert np.allclose(full, morph.offsets, atol=1e-7) and 0 < len(index) < 0.5 * len(full)
    assert max(follow["largest_move_mm"] for follow in made.facts["followed"]) > 1.0


def test_a_sequence_is_written_as_one_file_or_as_numbered_ones(tmp_path):
    options = MeshOptions(resolution=40, threshold=LEVEL, smoothing=0, formats=("ply",), colours=False)
    mesh_subject(HEAD, tmp_path, options, sequence=GAZES[1:])
    assert {"sequence.glb", "sequence.json", "rig.glb"} <= {path.name for path in tmp_path.iterdir()}
    with pytest.raises(UserError, match="--overwrite"):
        mesh_subject(HEAD, tmp_path, options, sequence=GAZES[1:])
    out = tmp_path / "numbered"
    made = mesh_subject(HEAD, out, options, sequence=GAZES[1:], numbered=True)
    assert [path.name for path in made.numbered] == ["0000", "0001"]
    assert sorted(path.name for path in (out / "sequence").iterdir()) == ["0000", "0001"]
    about = json.loads((out / "sequence" / "0001" / "face.json").read_text())
    assert about["gaze_pitch_yaw_degrees"] == pytest.approx([10.0, 0.0])
    widths = [trimesh.load(out / "sequence" / name / "face.ply").extents[0] for name in ("0000", "0001")]
    assert widths[1] == pytest.approx(1.02 * widths[0], rel=2e-3)
    assert not (out / "sequence.glb").exists()


def test_impossible_sequences_are_one_line(tmp_path):
    with pytest.raises(UserError, match="2 to 240"):
        mesh_subject(HEAD, tmp_path / "a", sequence=GAZES[:1])
    with pytest.raises(UserError, match="isosurface"):
        options = MeshOptions(surface="tsdf", resolution=32, colours=False, formats=("ply",))
        pytest.importorskip("open3d", reason="open3d cannot be loaded", exc_type=ImportError)
        mesh_subject(HEAD, tmp_path / "b", options, sequence=GAZES)
    assert not (tmp_path / "a").exists() and not (tmp_path / "b").exists()
