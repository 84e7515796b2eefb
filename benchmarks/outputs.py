"""What the commands write at small sizes, recorded and compared: held still while code moves.

python -m benchmarks.outputs record DIR [--tree PATH]   runs a fixed set of commands with the code of a tree
python -m benchmarks.outputs compare DIR_A DIR_B        says per file: same bytes, or the largest difference

`compare` exits 1 where something differs by more than rounding: pictures by more than `PICTURE_STEPS`
of 255 or below `PICTURE_PSNR`, numbers by more than `RELATIVE` and `ABSOLUTE`, vertices by more than
`VERTEX_METRES`, or where a file is missing.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from PIL import Image
from safetensors.numpy import load_file

ROOT = Path(__file__).parent.parent
PICTURE_STEPS, PICTURE_PSNR = 3, 55.0
RELATIVE, ABSOLUTE = 1e-3, 1e-5
VERTEX_METRES = 2e-6

GAZE = ["--gaze", "8", "-12"]
COMMANDS: dict[str, list[str]] = {
    "orbit-exact": ["orbit", "--out", "{}", "--speed", "exact", "--frames", "3", "--size", "64", *GAZE],
    "orbit-guided": ["orbit", "--out", "{}", "--speed", "guided", "--frames", "4", "--size", "96"],
    "orbit-baked": ["orbit", "--out", "{}", "--speed", "baked", "--frames", "6", "--size", "96"],
    "orbit-baked-held": ["orbit", "--out", "{}", "--speed", "baked", "--frames", "3", "--size", "96", *GAZE],
    "orbit-panels": [
        "orbit", "--out", "{}", "--frames", "2", "--size", "64", "--no-labels", "--panels", "image", "face", "eyes",
        "depth", "normals", "opacity", "reference",
    ],
    "sheet-grid": ["sheet", "--out", "{}/grid.png", "--size", "96"],
    "sheet-contact": ["sheet", "--out", "{}/contact.png", "--kind", "contact", "--size", "64", "--views", "-30", "30"],
    "mesh": ["mesh", "--out", "{}", "--resolution", "64", "--formats", "glb", "ply", "obj", "stl", *GAZE],
    "mesh-texture": [
        "mesh", "--out", "{}", "--resolution", "48", "--texture", "1024", "--formats", "glb", "obj", "--rig",
        "--max-faces", "4000", "--smooth", "4",
    ],
    "mesh-sequence": [
        "mesh", "--out", "{}", "--resolution", "48", "--formats", "ply", "--sequence", "circle", "--sequence-frames",
        "4",
    ],
    "mesh-tsdf": [
        "mesh", "--out", "{}", "--resolution", "40", "--surface", "tsdf", "--parts", "face", "--formats", "ply",
    ],
    "mesh-print": ["mesh", "--out", "{}", "--for", "print", "--resolution", "48"],
    "mesh-volume": [
        "mesh", "--out", "{}", "--parts", "eyes", "--resolution", "32", "--formats", "ply", "--volume", "nrrd", "npz",
        "--points", "500", "--threshold", "p50", "--repair",
    ],
    "export": ["export", "--out", "{}", "--frames", "6", "--size", "128", "--points", "900"],
    "check": ["check", "--out", "{}", "--views", "3", "--gazes", "2", "--size", "64", "--no-error-mesh"],
    "check-frames": ["check", "--out", "{}", "--frames", "{root}/export"],
    "synthesize": ["synthesize", "--out", "{}", "--people", "2", "--views", "6", "--size", "64", "--seed", "3"],
    "train": [
        "train", "--data", "{root}/synthesize", "--out", "{}", "--preset", "tiny", "--device", "cpu", "--precision",
        "float32", "--set", "steps=20", "perceptual=0",
    ],
    "evaluate": [
        "evaluate", "--data", "{root}/synthesize", "--out", "{}/quality.json", "--limit", "1", "--no-iris",
        "--held-out-views", "0.3",
    ],
    "subjects": ["subjects", "--json"],
}  # fmt: skip
"""Name of a folder to the words of a command; `{}` is that folder, `{root}` the one around all of them."""

VARYING = re.compile(
    r"seconds|made|versions|about\.source|file|minutes|command|software|libraries|meaning|label|group|options"
)
"""Keys of JSON files whose values are times, versions, paths or words for people."""

LOOSER = 50.0
"""How much more error bars and what an optimiser learned may differ."""

LEARNED = ("train/", "evaluate/")
"""Outputs of training: steps of an optimiser amplify rounding."""


def record(out: Path, tree: Path) -> None:
    """Run every command with the code of a tree; what it writes stays below `out`."""
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    environment = os.environ | {"OMP_NUM_THREADS": "1", "PYTHONPATH": str(tree), "PYOPENGL_PLATFORM": "egl"}
    seconds: dict[str, float] = {}
    for name, words in COMMANDS.items():
        folder = out / name
        folder.mkdir()
        filled = [word.replace("{root}", str(out)).replace("{}", str(folder)) for word in words]
        if words[0] == "check":
            folder.rmdir()
        started = time.perf_counter()
        command = [sys.executable, "-m", "gazenerf.cli.main", *filled]
        done = subprocess.run(command, cwd=tree, env=environment, capture_output=True, text=True, check=False)
        seconds[name] = round(time.perf_counter() - started, 1)
        print(f"{name}: exit {done.returncode}, {seconds[name]} s", flush=True)
        if done.returncode:
            print(done.stderr[-2000:])
        if name == "subjects":
            (folder / "subjects.json").write_text(done.stdout)
    (out / "seconds.json").write_text(json.dumps(seconds, indent=1) + "\n")


@dataclass(frozen=True)
class Finding:
    """Two versions of one file.

    Attributes:
        name: Path below the recorded folder.
        same: The same but for rounding.
        text: What differs.
    """

    name: str
    same: bool
    text: str


def compare(a: Path, b: Path) -> Iterator[Finding]:
    """Every file of two recorded folders against the file of the same name."""
    names = sorted({str(path.relative_to(root)) for root in (a, b) for path in root.rglob("*") if path.is_file()})
    for name in names:
        if name == "seconds.json" or name.endswith((".html", "state.pt")):
            continue
        first, second = a / name, b / name
        if not (first.is_file() and second.is_file()):
            yield Finding(name, False, f"only in {a if first.is_file() else b}")
        elif first.read_bytes() == second.read_bytes():
            yield Finding(name, True, "same bytes")
        else:
            yield _difference(name, first, second)


def _difference(name: str, a: Path, b: Path) -> Finding:
    suffix = a.suffix.lower()
    if suffix in (".png", ".jpg"):
        return _pictures(name, a, b)
    if suffix in (".json", ".jsonl"):
        return _numbers(name, dict(_leaves(_json(a))), dict(_leaves(_json(b))))
    if suffix in (".npz", ".safetensors"):
        return _numbers(name, _arrays(a), _arrays(b))
    if suffix in (".glb", ".ply", ".obj", ".stl"):
        return _meshes(name, a, b)
    if suffix in (".txt", ".mtl"):
        return _numbers(name, _words(a), _words(b))
    return Finding(name, False, "bytes differ")


def _pictures(name: str, a: Path, b: Path) -> Finding:
    first, second = (np.asarray(Image.open(path)).astype(float) for path in (a, b))
    if first.shape != second.shape:
        return Finding(name, False, f"{first.shape} and {second.shape}")
    apart = np.abs(first - second)
    psnr = 10.0 * math.log10(255.0**2 / max(float((apart**2).mean()), 1e-12))
    same = apart.max() <= PICTURE_STEPS and psnr >= PICTURE_PSNR
    return Finding(name, bool(same), f"{apart.max():.0f} of 255 at most, {psnr:.1f} dB")


def _json(path: Path) -> Any:
    text = path.read_text()
    return [json.loads(line) for line in text.splitlines()] if path.suffix == ".jsonl" else json.loads(text)


def _leaves(value: Any, place: str = "") -> Iterator[tuple[str, Any]]:
    if isinstance(value, dict):
        for key, item in value.items():
            if not VARYING.search(str(key)):
                yield from _leaves(item, f"{place}.{key}")
    elif isinstance(value, list):
        for number, item in enumerate(value):
            yield from _leaves(item, f"{place}.{number}")
    else:
        yield place, value


def _arrays(path: Path) -> dict[str, Any]:
    if path.suffix == ".safetensors":
        return dict(load_file(path))
    with np.load(path, allow_pickle=False) as file:
        return {name: file[name] for name in file.files}


def _words(path: Path) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for number, word in enumerate(path.read_text().split()):
        try:
            found[str(number)] = float(word)
        except ValueError:
            found[str(number)] = word
    return found


def _numbers(name: str, a: dict[str, Any], b: dict[str, Any]) -> Finding:
    """Values by name: words must be equal, numbers close."""
    if missing := sorted(set(a) ^ set(b)):
        only = [key for key in missing if key in a]
        return Finding(name, False, f"{len(missing)} values on one side only, such as {(only or missing)[0]}")
    worst, where, wrong = 0.0, "", []
    for key, value in a.items():
        other = b[key]
        if isinstance(value, (str, bool)) or value is None or other is None or isinstance(other, str):
            if value != other:
                wrong.append(f"{key}: {value} and {other}")
            continue
        first, second = (np.asarray(item, dtype=np.float64) for item in (value, other))
        if first.shape != second.shape:
            wrong.append(f"{key}: {first.shape} and {second.shape}")
            continue
        apart = np.abs(first - second) if first.size else np.zeros(1)
        scale = float(np.abs(first).max()) if first.size else 0.0
        share = float(apart.max()) / max(scale, ABSOLUTE / RELATIVE)
        share /= LOOSER if key.endswith(".error") else 1.0  # resampled
        if share > worst:
            worst, where = share, key
    if wrong:
        return Finding(name, False, "; ".join(wrong[:3]))
    allowed = LOOSER * RELATIVE if name.startswith(LEARNED) else RELATIVE
    return Finding(name, worst <= allowed, f"numbers {worst:.1e} apart{' at ' + where if where else ''}")


def _meshes(name: str, a: Path, b: Path) -> Finding:
    first, second = (_vertices(path) for path in (a, b))
    if first.shape != second.shape:
        return Finding(name, False, f"{len(first):,} and {len(second):,} vertices")
    apart = float(np.abs(first - second).max()) if first.size else 0.0
    limit = VERTEX_METRES * (1000.0 if a.suffix == ".stl" else 1.0)
    return Finding(name, apart <= limit, f"{len(first):,} vertices, {apart:.1e} apart")


def _vertices(path: Path) -> np.ndarray:
    loaded = trimesh.load(path, process=False)
    if isinstance(loaded, trimesh.Scene):
        parts = [mesh for mesh in loaded.geometry.values() if isinstance(mesh, trimesh.Trimesh)]
        return np.concatenate([np.asarray(mesh.vertices) for mesh in parts])
    assert isinstance(loaded, (trimesh.Trimesh, trimesh.PointCloud))
    return np.asarray(loaded.vertices)


def main() -> int:
    """Record or compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    actions = parser.add_subparsers(dest="action", required=True)
    recording = actions.add_parser("record")
    recording.add_argument("out", type=Path)
    recording.add_argument("--tree", type=Path, default=ROOT)
    comparing = actions.add_parser("compare")
    comparing.add_argument("a", type=Path)
    comparing.add_argument("b", type=Path)
    args = parser.parse_args()
    if args.action == "record":
        record(args.out.resolve(), args.tree.resolve())
        return 0
    findings = list(compare(args.a, args.b))
    for finding in findings:
        if finding.text != "same bytes":
            print(f"{'  ' if finding.same else '! '}{finding.name}: {finding.text}")
    equal = sum(finding.text == "same bytes" for finding in findings)
    wrong = sum(not finding.same for finding in findings)
    print(f"{len(findings)} files: {equal} the same bytes, {len(findings) - equal - wrong} to rounding, {wrong} not")
    return 1 if wrong else 0


if __name__ == "__main__":
    raise SystemExit(main())
