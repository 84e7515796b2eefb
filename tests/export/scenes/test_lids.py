"""Lids of a rig: targets by ARKit's names that follow the density, one eye each, and the table that drives them."""

from __future__ import annotations

import json

import numpy as np
import pytest
import torch
import trimesh

from gazenerf.export.formats.gltf import glb
from gazenerf.export.formats.nodes import Node
from gazenerf.export.mesh.sphere_fit import Eyeball
from gazenerf.export.scenes.lids import left_share, lid_weights, with_lids
from gazenerf.export.scenes.rig import SWEEP, Scene, eyes_clip, gaze_table
from gazenerf.geometry import Gaze
from gazenerf.geometry.paths import GazeRange
from gazenerf.head_model.lids import LOOKS
from gazenerf.heads.analytic import AnalyticField, AnalyticHead

LEVEL = 100.0


class Lids(AnalyticField):
    """A face that swells about the eyes by 2 mm at 10 degrees of pitch."""

    def __init__(self, gaze):
        super().__init__(gaze, sharpness=0.2)

    def density(self, points, part="head"):
        amount = 0.02 * self.gaze.pitch / np.deg2rad(10.0) if part == "face" else 0.0
        return super().density(points / (1.0 + amount), part)


class Head(AnalyticHead):
    trained_range = GazeRange(float(np.deg2rad(10.0)), float(np.deg2rad(20.0)))


@pytest.fixture(scope="module")
def made():
    """The face, the eyeballs and the rig with lids."""
    bound = Lids(Gaze())
    face = trimesh.creation.icosphere(5)
    face.apply_transform(np.diag([*bound.face.radii, 1.0]))
    eyes = [Eyeball(ball.centre, 0.12, 0.0, 100, 1.0) for ball in bound.eyes]
    keys = [Gaze.from_degrees(*angles) for angles in SWEEP]
    root = Node("head", children=(Node("face", face),), extras={"gaze": gaze_table(Head(Lids))})
    clip = eyes_clip("gaze sweep", keys, np.arange(7.0))
    scene = Scene(root, (clip,), {"gaze": root.extras["gaze"]}, (eyes[0], eyes[1]))
    return face, eyes, with_lids(Head(Lids), scene, face, LEVEL)


def test_each_target_reaches_the_surface_of_its_gaze_about_its_own_eye(made):
    face, eyes, scene = made
    morphs = {morph.name: 10.0 * morph.offsets for morph in scene.root.children[0].morphs}  # world units
    assert list(morphs) == list(LOOKS)
    looked_up = Lids(Gaze.from_degrees(10.0, 0.0))
    for side, eye in zip(("Left", "Right"), eyes, strict=True):
        close = np.linalg.norm(face.vertices - eye.centre, axis=1) < 2.0 * eye.radius
        places = torch.from_numpy((face.vertices + morphs[f"eyeLookUp{side}"])[close]).float()
        assert np.abs(looked_up.density(places, "face").numpy() - LEVEL).max() < 0.1 * LEVEL
        other = np.sign(face.vertices[:, 0]) == -np.sign(eye.centre[0])
        assert not morphs[f"eyeLookUp{side}"][other & (np.abs(face.vertices[:, 0]) > 0.08)].any()
        assert not morphs[f"eyeLookOut{side}"].any(), "this density does not follow the yaw"
    assert np.abs(morphs["eyeLookDownLeft"] + morphs["eyeLookUpLeft"]).max() < 2e-3
    assert scene.facts["lids_move_up_to_mm"] == pytest.approx(2.0, abs=0.3)


def test_both_sides_together_are_the_whole_move():
    eyes = [Eyeball(np.array([x, 0.0, 0.8]), 0.12, 0.0, 100, 1.0) for x in (0.35, -0.25)]
    places = np.array([[x, 0.0, 0.9] for x in (-0.3, 0.0, 0.05, 0.1, 0.4)])
    left = left_share(places, eyes)
    assert left == pytest.approx([0.0, left[1], 0.5, 1.0 - left[1], 1.0]) and 0.0 < left[1] < 0.5


def test_the_table_says_what_drives_what(made):
    lids = made[2].root.extras["gaze"]["lids"]
    assert lids["eyeLookDownRight"] == {"angle": "pitch", "degrees": pytest.approx(-10.0)}
    assert lids["eyeLookInRight"] == lids["eyeLookOutLeft"] == {"angle": "yaw", "degrees": pytest.approx(20.0)}
    weights = dict(zip(lids, lid_weights(lids, -5.0, 30.0), strict=True))
    on = {name for name, weight in weights.items() if weight}
    assert on == {"eyeLookDownLeft", "eyeLookDownRight", "eyeLookOutLeft", "eyeLookInRight"}
    assert weights["eyeLookDownLeft"] == pytest.approx(0.5) and weights["eyeLookOutLeft"] == 1.0


@pytest.mark.parametrize("compressed", [False, True])
def test_the_file_carries_table_targets_and_a_clip_that_drives_them(made, compressed):
    face, _, scene = made
    root = Node("head", children=(*scene.root.children, Node("eye_left"), Node("eye_right")), extras=scene.root.extras)
    data = glb(root, scene.clips, compressed=compressed)
    tree = json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])
    nodes = {node["name"]: node for node in tree["nodes"]}
    assert nodes["head"]["extras"]["gaze"]["lids"].keys() == LOOKS.keys()
    assert tree["meshes"][0]["extras"]["targetNames"] == list(LOOKS)
    paths = [channel["target"]["path"] for channel in tree["animations"][0]["channels"]]
    assert sorted(paths) == ["rotation", "rotation", "weights"]
    position = tree["accessors"][tree["meshes"][0]["primitives"][0]["attributes"]["POSITION"]]
    scale = nodes["face"].get("scale", [1.0])[0]
    most = 32767.0 if compressed else 1.0
    assert np.array(position["max"]) / most * scale == pytest.approx(face.bounds[1], abs=2e-5)
    assert ("KHR_mesh_quantization" in tree.get("extensionsRequired", [])) == compressed
    up = tree["accessors"][tree["meshes"][0]["primitives"][0]["targets"][0]["POSITION"]]
    assert up["max"][2] * scale == pytest.approx(scene.root.children[0].morphs[0].offsets[:, 2].max(), abs=1e-6)
