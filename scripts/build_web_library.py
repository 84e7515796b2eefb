"""Write gazenerf/assets/web/three.min.js, what index.html of `gazenerf mesh --for web` needs of three.js, in one file.

python scripts/build_web_library.py

The packages come from the npm registry and must have the SHA-256 below. npm and Linux on x86-64 are needed; esbuild
writes the same file on every machine, whose SHA-256 is printed and tested (tests/export/formats/test_page.py).
"""

from __future__ import annotations

import hashlib
import shutil
import subprocess
import tarfile
import tempfile
from pathlib import Path

TARGET = Path(__file__).parent.parent / "gazenerf" / "assets" / "web"

PACKAGES = {
    "three@0.187.0": "ff540832ded0cfe919764d24a3d88f3e2a05f23303f876423e4f893841e90728",
    "@esbuild/linux-x64@0.28.2": "9573bb2233aab0f9ea7647d5cca9726113cc1768de61d66b17267f4db84488f6",
}

ENTRY = """
export { AnimationMixer, Box3, HemisphereLight, MeshBasicMaterial, PerspectiveCamera, Scene, Timer, Vector3,
  WebGLRenderer } from 'three';
export { GLTFLoader } from 'three/addons/loaders/GLTFLoader.js';
export { OrbitControls } from 'three/addons/controls/OrbitControls.js';
"""

OPTIONS = ("--bundle", "--minify", "--format=iife", "--global-name=THREE", "--charset=ascii", "--target=es2022")


def unpacked(name: str, folder: Path) -> Path:
    """Fetch an npm package into an empty folder; where its files are.

    Raises:
        SystemExit: it is another file than the one that was looked at.
    """
    folder.mkdir(parents=True)
    subprocess.run(["npm", "pack", "--silent", name], cwd=folder, check=True, stdout=subprocess.DEVNULL)
    (archive,) = folder.glob("*.tgz")
    if (found := hashlib.sha256(archive.read_bytes()).hexdigest()) != PACKAGES[name]:
        raise SystemExit(f"{name} has SHA-256 {found}, not {PACKAGES[name]}")
    with tarfile.open(archive) as files:
        files.extractall(folder, filter="data")
    return folder / "package"


def main() -> None:
    """Fetch, bundle, write."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        three, esbuild = (unpacked(package, folder / str(i)) for i, package in enumerate(PACKAGES))
        (folder / "node_modules").mkdir()
        shutil.move(three, folder / "node_modules" / "three")
        licence = (folder / "node_modules" / "three" / "LICENSE").read_text(encoding="utf-8")
        (folder / "entry.js").write_text(ENTRY, encoding="ascii")
        out = folder / "three.min.js"
        command = [str(esbuild / "bin" / "esbuild"), "entry.js", *OPTIONS, "--legal-comments=none", f"--outfile={out}"]
        subprocess.run([*command, f"--banner:js=/*\nthree.js 0.187.0\n\n{licence}*/"], cwd=folder, check=True)
        code = out.read_bytes()
        TARGET.mkdir(parents=True, exist_ok=True)
        (TARGET / "three.min.js").write_bytes(code)
        (TARGET / "three.LICENSE").write_text(licence, encoding="utf-8")
    print(f"wrote {TARGET / 'three.min.js'}, {len(code):,} bytes, SHA-256 {hashlib.sha256(code).hexdigest()}")


if __name__ == "__main__":
    main()
