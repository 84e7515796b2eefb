"""`gazenerf mesh`: arguments, presets, what is said and written."""

from __future__ import annotations

import json

import pytest
import trimesh

import gazenerf.export.appearance.colours
from gazenerf.cli import mesh
from gazenerf.cli.main import build_parser, main
from gazenerf.cli.parser import parsed
from gazenerf.export.options import PRESETS, MeshOptions
from gazenerf.heads.analytic import AnalyticField, AnalyticHead
from gazenerf.options import to_dict


@pytest.fixture
def analytic(monkeypatch):
    """The command meshes the analytic field."""
    monkeypatch.setattr(gazenerf.export.appearance.colours, "PICTURE", 96)
    head = AnalyticHead(lambda gaze: AnalyticField(gaze, sharpness=0.2))
    monkeypatch.setattr("gazenerf.cli.arguments.SourceArguments.load", lambda self: head)


def options_of(*typed: str) -> mesh.Options:
    return parsed(mesh.Options, build_parser(["mesh"]).parse_args(["mesh", "--out", "x", *typed]))


def test_without_arguments_nothing_but_the_defaults():
    found, usual = to_dict(options_of()), to_dict(MeshOptions())
    assert usual.items() <= found.items()


@pytest.mark.parametrize("use", PRESETS)
def test_presets_are_offered_and_given_arguments_win(use):
    expected = to_dict(MeshOptions.preset(use))
    assert expected.items() <= to_dict(options_of("--for", use)).items()
    given = to_dict(options_of("--for", use, "--formats", "obj", "--resolution", "64", "--no-colours"))
    assert (expected | {"formats": ["obj"], "resolution": 64, "colours": False}).items() <= given.items()


def test_web_writes_textured_parts_and_a_rig(analytic, tmp_path, capsys):
    words = ["--resolution", "48", "--threshold", "100", "--max-faces", "3000"]
    assert main(["mesh", "--out", str(tmp_path), "--for", "web", *words]) == 0
    written = {path.name for path in tmp_path.iterdir()}
    assert written == {"face.glb", "face.json", "eyes.glb", "eyes.json", "rig.glb", "rig.json", "index.html"}
    assert "face texture" in capsys.readouterr().out
    face = trimesh.load(tmp_path / "face.glb", force="mesh", process=False)
    assert face.visual.material.baseColorTexture.size == (1024, 1024)
    assert json.loads((tmp_path / "face.json").read_text())["faces"] <= 3000


def test_a_preset_s_rig_can_be_left_out():
    asked = [
        options_of("--for", "web", *words)
        for words in ([], ["--no-rig"], ["--no-page"], ["--parts", "face"], ["--parts", "face", "--rig"])
    ]
    assert [options.rig for options in asked] == [True, False, True, False, True]
    assert [options.page for options in asked] == [True, False, False, False, False]


def test_print_is_one_closed_solid_in_millimetres(analytic, tmp_path):
    words = ["--resolution", "48", "--threshold", "100"]
    assert main(["mesh", "--out", str(tmp_path), "--for", "print", *words]) == 0
    solid = trimesh.load(tmp_path / "head.stl")
    assert solid.is_watertight and solid.extents[1] == pytest.approx(220.0, abs=2.0)
    assert json.loads((tmp_path / "head.json").read_text())["stl_units"] == "millimetres"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--volume", "dicom"], "nrrd, vti, npz"),
        (["--points", "0"], "--points goes from 1"),
        (["--texture", "1000"], "1024"),
        (["--for", "unity"], "blender"),
        (["--formats", "fbx"], "unknown format"),
    ],
)
def test_bad_arguments_are_one_line(analytic, tmp_path, capsys, words, message):
    try:
        code = main(["mesh", "--out", str(tmp_path / "out"), *words])
    except SystemExit as stop:
        code = stop.code
    said = capsys.readouterr().err.strip()
    assert code == 2 and message in said and "\n" not in said
    assert not (tmp_path / "out").exists()
