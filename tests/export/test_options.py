"""Settings that fit a use; what is given wins."""

from __future__ import annotations

import pytest

from gazenerf.errors import UserError
from gazenerf.export import MeshOptions
from gazenerf.export.options import PRESETS


def test_given_wins_over_preset_wins_over_default():
    assert MeshOptions.preset(None) == MeshOptions()
    web = MeshOptions.preset("web", texture=4096)
    assert (web.texture, web.max_faces, web.parts) == (4096, 15_000, ("face", "eyes"))
    assert MeshOptions.preset("blender", smoothing=0, colours=False).smoothing == 0
    assert MeshOptions.preset("blender", colours=False).colours is False
    with pytest.raises(UserError, match="blender, web, print, research"):
        MeshOptions.preset("unity")


@pytest.mark.parametrize("use", PRESETS)
def test_every_preset_can_be_made(use):
    MeshOptions.preset(use).check()


def test_a_presets_rig_goes_with_the_parts_it_needs():
    assert MeshOptions.preset("web").rig and not MeshOptions.preset("web", rig=False).rig
    assert not MeshOptions.preset("web", parts=("face",)).rig
    assert MeshOptions.preset("web", parts=("face",), rig=True).rig, "refused later, aloud"


def test_words_given_twice_count_once():
    assert MeshOptions(parts=("face", "eyes", "face"), formats=("glb", "glb")) == MeshOptions(formats=("glb",))


def test_what_is_left_open_depends_on_how_the_surface_is_known():
    settled = MeshOptions().settled("face", distances=True)
    assert (settled.resolution, settled.smoothing, settled.max_faces) == (320, 0, 150_000)
    eyes = MeshOptions().settled("eyes", distances=True)
    assert (eyes.resolution, eyes.smoothing, eyes.max_faces) == (192, 0, None)
    plain = MeshOptions().settled("face", distances=False)
    assert (plain.resolution, plain.smoothing, plain.max_faces) == (192, 40, None)
    assert MeshOptions(volumes=("npz",)).settled("face", distances=True).resolution == 192
    textured = MeshOptions(texture=1024).settled("face", distances=True)
    assert (textured.resolution, textured.max_faces) == (320, 20_000)


def test_what_is_given_is_not_settled_otherwise():
    given = MeshOptions(resolution=64, smoothing=3)
    assert given.settled("face", distances=True) == given
    assert MeshOptions(max_faces=500).settled("head", distances=True).max_faces == 500
