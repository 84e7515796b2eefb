"""Settings that fit a use; what is given wins."""

from __future__ import annotations

import inspect

import pytest

from gazenerf.errors import UserError
from gazenerf.export import extract_part, mesh_subject
from gazenerf.export.options import DEFAULTS, PRESETS, RIGGED, settings


def test_presets_speak_the_language_of_mesh_subject():
    known = {**inspect.signature(mesh_subject).parameters, **inspect.signature(extract_part).parameters}
    assert set(DEFAULTS) <= set(known) and all(set(preset) <= set(DEFAULTS) for preset in PRESETS.values())
    assert set(RIGGED) <= set(PRESETS)
    assert {name: known[name].default for name in DEFAULTS} == DEFAULTS


def test_given_wins_over_preset_wins_over_default():
    assert settings(None, {}) == DEFAULTS
    web = settings("web", {"max_faces": None, "texture": 4096})
    assert (web["texture"], web["max_faces"], web["parts"]) == (4096, 15_000, ("face", "eyes"))
    assert settings("blender", {"smoothing": 0, "colours": False})["smoothing"] == 0
    assert settings("blender", {"colours": False})["colours"] is False
    with pytest.raises(UserError, match="blender, web, print, research"):
        settings("unity", {})
