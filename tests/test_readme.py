"""The documents do what they say: the example runs, files exist, the command reference is current."""

import os
import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest
import trimesh
from PIL import Image

from gazenerf.checkpoints import BUNDLED
from gazenerf.cli.main import COMMANDS
from gazenerf.subjects import bundled_subjects

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")
EXAMPLE = re.findall(r"```python\n(.*?)```", README, re.DOTALL)


@pytest.mark.skipif(not (BUNDLED.is_file() and bundled_subjects()), reason="no field is bundled in this checkout")
def test_the_example_runs(tmp_path):
    (code,) = EXAMPLE
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    subprocess.run([sys.executable, "-c", code], cwd=tmp_path, check=True, timeout=300, env=environment)
    assert Image.open(tmp_path / "head.png").size == (512, 512)
    eyes = trimesh.load(tmp_path / "meshes" / "eyes.glb", force="mesh")
    width = eyes.bounds[1] - eyes.bounds[0]
    assert 0.05 < width[0] < 0.13 and width[1] < 0.04, "two eyeballs, in metres"


def test_the_example_is_short():
    lines = [line for line in EXAMPLE[0].splitlines() if line.strip()]
    assert len(lines) <= 10


def test_every_command_is_named():
    assert all(re.search(rf"\b{name}\b", README) for name in COMMANDS)


@pytest.mark.parametrize("page", sorted([ROOT / "README.md", *(ROOT / "docs").glob("*.md")]), ids=lambda p: p.name)
def test_links_lead_somewhere(page):
    text = page.read_text(encoding="utf-8")
    linked = re.findall(r"\]\((?!https?://|#)([^)#]+)", text)
    missing = [link for link in linked if not (page.parent / link).exists()]
    assert not missing


def test_the_command_reference_is_current():
    script = runpy.run_path(str(ROOT / "scripts" / "build_command_reference.py"))
    written = (ROOT / "docs" / "commands.md").read_text(encoding="utf-8")
    assert written == script["reference"](), "run: python scripts/build_command_reference.py"


def test_the_version_is_the_same_everywhere():
    from gazenerf import __version__

    assert f"version: {__version__}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert f"## {__version__}\n" in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
