"""The Khronos glTF validator finds nothing to say.

It is an npm package: `npm install --no-save --prefix DIR gltf-validator`, then
`GLTF_VALIDATOR=DIR/node_modules/gltf-validator` names it to these tests.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess

import pytest

import gazenerf.export.appearance.colours
from gazenerf.export import MeshOptions, mesh_subject
from gazenerf.geometry import Gaze
from gazenerf.heads.analytic import AnalyticField, AnalyticHead

SCRIPT = """
const fs = require('fs'), validator = require(process.argv[1]);
validator.validateBytes(new Uint8Array(fs.readFileSync(process.argv[2])), { maxIssues: 20 })
  .then((report) => console.log(JSON.stringify(report)));
"""


@pytest.fixture(scope="module")
def validate():
    """A path to the report on it."""
    package, node = os.environ.get("GLTF_VALIDATOR"), shutil.which("node")
    if node is None:
        pytest.skip("node is not installed")
    if not package:
        pytest.skip("GLTF_VALIDATOR does not name the npm package gltf-validator")

    def run(path):
        command = [node, "-e", SCRIPT, os.path.abspath(package), str(path)]  # noqa: PTH100
        done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120)
        return json.loads(done.stdout)

    return run


def bind(gaze):
    return AnalyticField(gaze, sharpness=0.2)


@pytest.mark.parametrize("compress", [False, True])
@pytest.mark.parametrize("texture", [None, 1024])
def test_no_errors_and_no_warnings(validate, tmp_path, monkeypatch, texture, compress):
    monkeypatch.setattr(gazenerf.export.appearance.colours, "PICTURE", 96)
    options = MeshOptions(resolution=40, threshold=100.0, formats=("glb",), texture=texture, compress=compress)
    gazes = [Gaze.from_degrees(0.0, 10.0), Gaze.from_degrees(10.0, 0.0)]
    mesh_subject(AnalyticHead(bind), tmp_path, options, sequence=gazes)
    for name in ("face.glb", "eyes.glb", "rig.glb", "sequence.glb"):
        report = validate(tmp_path / name)
        assert report["issues"]["messages"] == [], name
        assert report["issues"]["numErrors"] == report["issues"]["numWarnings"] == 0
        assert report["info"]["hasTextures"] == (texture is not None or name in ("rig.glb", "sequence.glb"))
