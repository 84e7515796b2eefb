"""Every example runs as it stands and writes what it says."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from gazenerf.checkpoints import BUNDLED
from gazenerf.viz.reference.views import usable

EXAMPLES = Path(__file__).parent.parent / "examples"

RUNS: dict[str, tuple[list[str], list[str]]] = {
    "00_render.py": ([], ["head.png", "face.png", "eyes.png"]),
    "01_orbit.py": (["4"], ["orbit.mp4"]),
    "02_mesh.py": (["32"], ["face.glb", "face.json", "eyes.ply"]),
    "03_rig.py": (["32"], ["rig.glb", "sequence.glb"]),
    "04_check.py": (["2", "64"], ["report.html", "report.json"]),
    "05_train.py": (["4"], ["run/field.safetensors", "quality.json"]),
}
"""Example to its arguments after the folder, and files that it writes."""


def test_every_example_is_run_here():
    assert sorted(path.name for path in EXAMPLES.glob("*.py")) == sorted(RUNS)


@pytest.mark.parametrize("name", RUNS)
def test_it_is_short_and_says_how_to_run_it(name):
    lines = (EXAMPLES / name).read_text(encoding="utf-8").splitlines()
    assert 20 <= len(lines) <= 60 and any(f"python examples/{name}" in line for line in lines)


@pytest.mark.skipif(not BUNDLED.is_file(), reason="no field is bundled in this checkout")
@pytest.mark.parametrize("name", RUNS)
def test_it_runs(name, tmp_path):
    if name in ("04_check.py", "05_train.py") and not usable("pyrender"):
        pytest.skip("pyrender finds no off-screen OpenGL here")
    words, files = RUNS[name]
    environment = os.environ | {"OMP_NUM_THREADS": "1", "PYOPENGL_PLATFORM": "egl"}
    command = [sys.executable, str(EXAMPLES / name), str(tmp_path), *words]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout.strip() and all((tmp_path / file).is_file() for file in files)
