"""What is installed: packages under one name, pages and templates inside, links that an index can follow."""

from __future__ import annotations

import os
import runpy
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
BASE = "https://example.org/owner/gazenerf/blob/main"


@pytest.fixture(scope="module")
def script():
    return runpy.run_path(str(ROOT / "scripts" / "build_distributions.py"))


@pytest.fixture(scope="module")
def built(script, tmp_path_factory) -> dict[str, set[str]]:
    """Kind of distribution to its files."""
    if not (ROOT / ".git").exists():
        pytest.skip("this is no git checkout, so the tracked files are not known")
    out = tmp_path_factory.mktemp("dist")
    command = [sys.executable, str(ROOT / "scripts" / "build_distributions.py"), "--links", BASE, "--out", str(out)]
    subprocess.run(command, check=True, capture_output=True, timeout=300)
    (sdist,), (wheel,) = list(out.glob("*.tar.gz")), list(out.glob("*.whl"))
    with tarfile.open(sdist) as archive:
        source = {name.partition("/")[2] for name in archive.getnames()}
    with zipfile.ZipFile(wheel) as archive:
        installed = set(archive.namelist())
        (about,) = [name for name in installed if name.endswith("METADATA")]
        text = archive.read(about).decode()
    return {"sdist": source, "wheel": installed, "links": set(text.split("](")[1:])}


def test_nothing_but_our_own_name_is_installed(built):
    tops = {name.split("/")[0] for name in built["wheel"]}
    assert {top for top in tops if not top.endswith(".dist-info")} == {"gazenerf"}
    assert {"gazenerf/viz/__init__.py", "gazenerf/export/pipeline.py", "gazenerf/__main__.py"} <= built["wheel"]
    assert any(name.startswith("gazenerf/viz/report/templates/") for name in built["wheel"])
    assert "gazenerf/assets/fields/portrait.safetensors" in built["wheel"]
    assert {"gazenerf/assets/web/three.min.js", "gazenerf/assets/web/three.LICENSE"} <= built["wheel"]
    assert {f"gazenerf/export/page/page.{kind}" for kind in ("html", "css", "js")} <= built["wheel"]


def test_pages_and_examples_travel_with_the_source(built):
    assert {"docs/conventions.md", "examples/00_render.py", "CHANGELOG.md", "constraints.txt"} <= built["sdist"]


def test_an_index_can_follow_every_link(built):
    assert built["links"] and all(link.startswith(("https://", "#")) for link in built["links"])


def test_links_are_made_absolute_and_no_others(script):
    text = "![a [b]](docs/a.webp) and [page](docs/b.md#top), [far](https://x.org), [here](#part)"
    expected = (
        "![a [b]](https://example.org/owner/gazenerf/raw/main/docs/a.webp) and "
        f"[page]({BASE}/docs/b.md#top), [far](https://x.org), [here](#part)"
    )
    assert script["absolute_links"](text, BASE) == expected


@pytest.mark.parametrize("name", ["viz", "export"])
def test_old_names_are_aliases_in_a_checkout_and_say_so(name):
    code = f"import {name}, gazenerf.{name} as new; assert {name}.__all__ == new.__all__"
    done = subprocess.run(
        [sys.executable, "-W", "always", "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0 and f"`{name}` is now `gazenerf.{name}`" in done.stderr


def test_a_file_called_export_in_the_working_folder_is_in_nobodys_way(tmp_path):
    (tmp_path / "export.py").write_text("raise SystemExit('wrong module')")
    code = "from gazenerf.export import MeshOptions; MeshOptions()"
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    subprocess.run([sys.executable, "-c", code], cwd=tmp_path, check=True, timeout=60, env=environment)


def test_python_m_gazenerf_is_the_command_line():
    done = subprocess.run(
        [sys.executable, "-m", "gazenerf", "--version"], cwd=ROOT, capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0 and done.stdout.startswith("gazenerf ")
