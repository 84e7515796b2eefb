"""Damaged and hostile files against everything that reads files from strangers.

    python -m benchmarks.fuzz --cases 1000 --seed 1
    python -m benchmarks.fuzz --cases 1000 --seed 1 --only subject --keep fuzz

A small sound example of every kind of file is damaged at random: bytes, JSON values, arrays. Each case is read as
the commands read it. It may be read, since much damage does no harm, or refused in one line (exit code 2 of a
command). Anything else is a finding and prints the seed that makes it again: another exception (a traceback),
files that appear, more than `--seconds`, or memory beyond `--memory`. The exit code is 1 where there are findings.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import re
import resource
import shutil
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image

from gazenerf.checkpoints import import_official, load_field, save_field
from gazenerf.data import CaptureSet
from gazenerf.data.captures import Capture
from gazenerf.data.storage import write_manifest, write_shard
from gazenerf.errors import UserError
from gazenerf.export.formats.volumes import read_nrrd, write_nrrd
from gazenerf.export.surface.densities import DensityGrid
from gazenerf.field.config import PRESETS, FieldConfig
from gazenerf.field.model import TwoStreamField
from gazenerf.geometry import Camera, Gaze
from gazenerf.geometry.keyframes import read_keyframes
from gazenerf.head_model import load_head_model
from gazenerf.head_model.generic import FORMAT
from gazenerf.photographs.landmarks import read_labels, read_landmarks, read_mask
from gazenerf.photographs.picture import read_photograph
from gazenerf.subjects import Codes, Subject, load_subject
from gazenerf.viz.check.frames import read_frames

SIZES = (4, 3, 5, 27)
"""Code sizes of the examples."""

WORDS: tuple[Any, ...] = (
    None, True, False, 0, -1, 1, 2**31, 2**63, -(2**70), 1e308, 1e-320, float("nan"), float("inf"), "", "x", "../../x",
    "a\0b", "9" * 400, "é" * 300, [], {}, [[]], [1, 2, 3], {"a": 1}, [0.0] * 3, [[1.0] * 4] * 4,
)  # fmt: skip
"""Values that take the place of others in JSON."""

NUMBERS = (b"0", b"-1", b"99999999999", b"1e999", b"NaN", b"", b"0x7f", b"\xff\xfe")
"""What takes the place of digits in text."""


@dataclass(frozen=True)
class Target:
    """One kind of file.

    Attributes:
        write: Writes a sound example to an empty folder and says which of its files are damaged.
        read: Reads the folder as a command would.
    """

    write: Callable[[Path], list[str]]
    read: Callable[[Path], Any]


def _codes(rng: np.random.Generator) -> Codes:
    return Codes(*(rng.standard_normal(size).astype(np.float32) for size in SIZES))


def _field(folder: Path) -> list[str]:
    identity, expression, texture, illumination = SIZES
    small = {"identity": identity, "expression": expression, "texture": texture, "illumination": illumination}
    torch.manual_seed(0)
    config = FieldConfig.from_dict(PRESETS["tiny"].to_dict() | small | {"hidden": 8, "feature_channels": 6})
    save_field(TwoStreamField(config), folder / "field.safetensors")
    return ["field.safetensors"]


def _subject(folder: Path) -> list[str]:
    Subject("someone", _codes(np.random.default_rng(0))).save(folder / "s.safetensors")
    return ["s.safetensors"]


def _captures(folder: Path) -> list[str]:
    rng = np.random.default_rng(0)
    image, parts = rng.integers(0, 255, (16, 16, 3), np.uint8), rng.integers(0, 4, (16, 16), np.uint8)
    depth = np.where(parts > 0, 12.0, 0.0).astype(np.float32)
    capture = Capture(image, parts, depth, Camera.neutral(16), Gaze(0.1, 0.2), _codes(rng), 0, 0)
    write_manifest(folder, {"people": 1, "views": 1, "seed": 1, "code_sizes": list(SIZES)})
    write_shard(folder, [capture])
    return sorted(path.name for path in folder.iterdir())


def _keyframes(folder: Path) -> list[str]:
    keys = [{"yaw": 0, "pitch": 15, "distance": 9, "fov": 12, "time": 0}, {"position": [0, 0, 12], "target": [0, 0, 0]}]
    pose = np.eye(4)
    pose[:3, 3] = 1.0, 2.0, 10.0
    (folder / "path.json").write_text(
        json.dumps({"loop": True, "keyframes": [*keys, {"world_from_camera": pose.tolist()}]})
    )
    return ["path.json"]


def _frames(folder: Path) -> list[str]:
    rng = np.random.default_rng(0)
    frames = []
    for i in range(4):
        Image.fromarray(rng.integers(0, 255, (24, 32, 3), np.uint8)).save(folder / f"{i}.png")
        np.save(folder / f"{i}.npy", np.full((24, 32), 900, np.uint16))
        pose = np.eye(4)
        pose[:3, 3] = 0.1 * i, 0.0, 1.0
        frames.append({"file_path": f"{i}.png", "depth_file_path": f"{i}.npy", "transform_matrix": pose.tolist()})
    lens = {"fl_x": 40.0, "fl_y": 40.0, "cx": 16.0, "cy": 12.0, "w": 32, "h": 24, "k1": 0.01, "camera_model": "OPENCV"}
    (folder / "transforms.json").write_text(json.dumps({**lens, "frames": frames}))
    return ["transforms.json", "transforms.json", "0.png", "0.npy"]


def _colmap(folder: Path) -> list[str]:
    model = folder / "sparse" / "0"
    model.mkdir(parents=True)
    (folder / "images").mkdir()
    rng = np.random.default_rng(0)
    lines = []
    for i in range(4):
        Image.fromarray(rng.integers(0, 255, (24, 32, 3), np.uint8)).save(folder / "images" / f"{i}.png")
        lines += [f"{i + 1} 1 0 0 0 {0.1 * i} 0 1 1 {i}.png", ""]
    (model / "cameras.txt").write_text("# cameras\n1 PINHOLE 32 24 40 40 16 12\n")
    (model / "images.txt").write_text("\n".join(lines) + "\n")
    (model / "points3D.txt").write_text("")
    return ["sparse/0/cameras.txt", "sparse/0/images.txt"]


def _pictures(folder: Path) -> list[str]:
    image = Image.fromarray(np.random.default_rng(0).integers(0, 255, (48, 40, 3), np.uint8))
    exif = Image.Exif()
    exif[274] = 6
    image.save(folder / "a.jpg", exif=exif)
    image.save(folder / "b.png")
    image.save(folder / "c.webp")
    image.convert("I;16").save(folder / "d.png")
    return ["a.jpg", "b.png", "c.webp", "d.png"]


def _landmarks(folder: Path) -> list[str]:
    points = np.random.default_rng(0).uniform(0, 100, (68, 2)).astype(np.float32)
    np.save(folder / "a.npy", points)
    np.savez(folder / "b.npz", landmarks=points)
    (folder / "c.json").write_text(json.dumps(points.tolist()))
    np.savetxt(folder / "d.csv", points, delimiter=",")
    return ["a.npy", "b.npz", "c.json", "d.csv"]


def _head_model(folder: Path) -> list[str]:
    rng = np.random.default_rng(0)
    arrays = {
        "format": np.array(FORMAT), "vertices": rng.standard_normal((80, 3)).astype(np.float32),
        "faces": rng.integers(0, 80, (90, 3)).astype(np.int64), "landmarks": np.arange(68),
        "eye_centres": np.array([[0.3, 0.0, 0.8], [-0.3, 0.0, 0.8]], np.float32),
        "identity": rng.standard_normal((2, 80, 3)).astype(np.float32), "metres_per_unit": np.array(0.1),
    }  # fmt: skip
    np.savez(folder / "head.npz", **arrays)
    return ["head.npz"]


_PUBLISHED = (
    (r"streams\.face\.", "fg_CD_predictor_face."),
    (r"streams\.eyes\.", "fg_CD_predictor_eyes."),
    (r"\.trunk\.(\d+)\.", r".FeaExt_module_\1."),
    (r"\.density\.", ".density_module."),
    (r"\.feature_(\d)\.", r".RGB_layer_\1."),
    (r"renderer\.background_features", "neural_render.bg_featmap"),
    (r"renderer\.upsample\.(\d+)\.widen_0", r"neural_render.feat_upsample_list.\1.layer_1"),
    (r"renderer\.upsample\.(\d+)\.widen_1", r"neural_render.feat_upsample_list.\1.layer_2"),
    (r"renderer\.to_rgb\.", "neural_render.feat_2_rgb_list."),
    (r"renderer\.narrow\.", "neural_render.feat_layers."),
)
"""Our names to published ones."""


def published_weights(field: TwoStreamField) -> dict[str, torch.Tensor]:
    """A field's weights under the published names and in the published shapes."""
    net = {}
    for name, value in field.state_dict().items():
        for ours, theirs in _PUBLISHED:
            name = re.sub(ours, theirs, name)
        flat = name.startswith("fg_CD") and value.dim() == 2
        net[name] = value[..., None, None].clone() if flat else value.clone()
    return net


def _published(folder: Path) -> list[str]:
    torch.manual_seed(1)
    field = TwoStreamField(FieldConfig(image_size=32, feature_size=8, feature_channels=6, hidden=8))
    weights = published_weights(field)
    torch.save({"net": weights, "options": argparse.Namespace(lr=1e-4), "iter": 3}, folder / "a.pth")
    torch.save(weights, folder / "b.pth", _use_new_zipfile_serialization=False)
    return ["a.pth", "b.pth"]


def _volume(folder: Path) -> list[str]:
    values = np.random.default_rng(0).random((4, 5, 6)).astype(np.float32)
    write_nrrd(DensityGrid(values, np.zeros(3), 0.1, values.size), folder / "v.nrrd")
    return ["v.nrrd"]


def _masks(folder: Path) -> list[str]:
    rng = np.random.default_rng(0)
    Image.fromarray(rng.integers(0, 2, (30, 20), np.uint8) * 255).save(folder / "mask.png")
    Image.fromarray(rng.integers(0, 19, (30, 20), np.uint8)).save(folder / "labels.png")
    return ["mask.png", "labels.png"]


def _each(read: Callable[[Path], Any], *names: str) -> Callable[[Path], list[Any]]:
    return lambda folder: [read(folder / name) for name in names]


TARGETS: dict[str, Target] = {
    "field": Target(_field, _each(load_field, "field.safetensors")),
    "subject": Target(_subject, _each(load_subject, "s.safetensors")),
    "captures": Target(_captures, lambda folder: list(CaptureSet(folder))),
    "keyframes": Target(_keyframes, _each(read_keyframes, "path.json")),
    "frames": Target(_frames, read_frames),
    "colmap": Target(_colmap, read_frames),
    "photograph": Target(_pictures, _each(read_photograph, "a.jpg", "b.png", "c.webp", "d.png")),
    "landmarks": Target(_landmarks, _each(read_landmarks, "a.npy", "b.npz", "c.json", "d.csv")),
    "masks": Target(
        _masks, lambda at: [read_mask(at / "mask.png", (20, 30)), read_labels(at / "labels.png", (20, 30))]
    ),
    "head-model": Target(_head_model, _each(load_head_model, "head.npz")),
    "published": Target(_published, _each(import_official, "a.pth", "b.pth")),
    "volume": Target(_volume, _each(read_nrrd, "v.nrrd")),
}
"""Kind of file to how it is written and read."""


def damage(path: Path, rng: np.random.Generator) -> str:
    """Damage a file in one of the ways that suit it; says which."""
    ways: list[Callable[[Path, np.random.Generator], None]] = [_bytes]
    if path.suffix == ".json":
        ways += [_json] * 4
    if path.suffix == ".safetensors":
        ways += [_header] * 4
    if path.suffix == ".npz":
        ways += [_arrays] * 3
    if path.suffix in (".txt", ".csv", ".nrrd"):
        ways += [_digits] * 3
    way = ways[rng.integers(len(ways))]
    way(path, rng)
    return way.__name__.strip("_")


def _bytes(path: Path, rng: np.random.Generator) -> None:
    data = bytearray(path.read_bytes())
    for _ in range(rng.integers(1, 4)):
        at = int(rng.integers(len(data) + 1))
        length = int(rng.integers(1, 1 + max(1, len(data) // int(rng.choice([2, 20, 200])))))
        match rng.integers(6):
            case 0:
                data[at : at + 1] = bytes([rng.integers(256)])
            case 1:
                del data[at:]
            case 2:
                data[at:at] = rng.bytes(min(length, 64))
            case 3:
                data[at : at + length] = bytes(len(data[at : at + length]))
            case 4:
                del data[at : at + length]
            case _:
                data[at:at] = data[at : at + length]
    path.write_bytes(bytes(data))


def _digits(path: Path, rng: np.random.Generator) -> None:
    data = path.read_bytes()
    places = [i for i, letter in enumerate(data) if 48 <= letter <= 57]
    at = int(rng.choice(places)) if places else 0
    path.write_bytes(data[:at] + NUMBERS[rng.integers(len(NUMBERS))] + data[at + 1 :])


def _json(path: Path, rng: np.random.Generator) -> None:
    path.write_text(_damaged_json(path.read_text(), rng))


def _damaged_json(text: str, rng: np.random.Generator) -> str:
    if rng.random() < 0.05:
        depth = int(rng.choice([50, 5000, 200_000]))
        return "[" * depth + "]" * depth
    content = json.loads(text)
    parent, key = _somewhere(content, rng)
    if parent is None:
        return json.dumps(WORDS[rng.integers(len(WORDS))])
    match rng.integers(4):
        case 0:
            del parent[key]
        case 1 if isinstance(parent, dict):
            parent[f"{key}x"] = parent.pop(key)
        case 2 if isinstance(parent, list):
            parent.extend(parent[:1000])
        case _:
            parent[key] = WORDS[rng.integers(len(WORDS))]
    return json.dumps(content)


def _somewhere(content: Any, rng: np.random.Generator) -> tuple[Any, Any]:
    """A container in JSON and one of its keys; nothing where there is none."""
    parent, key = None, None
    while isinstance(content, dict | list) and content and (parent is None or rng.random() < 0.7):
        keys = list(content) if isinstance(content, dict) else range(len(content))
        parent, key = content, keys[int(rng.integers(len(keys)))]
        content = parent[key]
    return parent, key


def _header(path: Path, rng: np.random.Generator) -> None:
    """The header of safetensors, or JSON inside of its metadata."""
    data = path.read_bytes()
    length = int.from_bytes(data[:8], "little")
    header = json.loads(data[8 : 8 + length])
    inside = [key for key, value in header.get("__metadata__", {}).items() if value[:1] in "[{"]
    if inside and rng.random() < 0.6:
        key = inside[rng.integers(len(inside))]
        header["__metadata__"][key] = _damaged_json(header["__metadata__"][key], rng)
        text = json.dumps(header)
    else:
        text = _damaged_json(json.dumps(header), rng)
    path.write_bytes(len(text.encode()).to_bytes(8, "little") + text.encode() + data[8 + length :])


def _arrays(path: Path, rng: np.random.Generator) -> None:
    with np.load(path) as file:
        arrays = dict(file)
    name = list(arrays)[rng.integers(len(arrays))]
    value = arrays[name]
    match rng.integers(8):
        case 0:
            del arrays[name]
        case 1 if value.dtype.kind == "f":
            arrays[name] = np.full_like(value, rng.choice([np.nan, np.inf, 1e38, -1.0]))
        case 2 if value.dtype.kind in "iu":
            arrays[name] = np.full_like(value, rng.choice([0, 127, 255]))
        case 3:
            arrays[name] = value[..., None]
        case 4:
            arrays[name] = value.reshape(-1)[: max(0, value.size - 1)]
        case 5:
            arrays[name] = np.array([{"a": 1}], dtype=object)
        case 6:
            arrays[name] = np.array("text")
        case _ if value.dtype.kind in "fiub":
            arrays[name] = value.astype(rng.choice(["complex64", "bool", "S4", "float16", "int8"]))
        case _:
            arrays[name] = np.array(["a", "b"])
    np.savez(path, **arrays)


@dataclass(frozen=True)
class Finding:
    """A case that went wrong.

    Attributes:
        kind: Of file.
        case: Number that makes it again with the same seed.
        how: File and way of the damage.
        what: What went wrong.
    """

    kind: str
    case: int
    how: str
    what: str


def run_case(
    kind: str, target: Target, seed: int, case: int, folder: Path, seconds: float
) -> tuple[str, list[Finding]]:
    """Damage one example and read it.

    Args:
        kind, target: Of file.
        seed, case: They say what is damaged, and how.
        folder: Empty.
        seconds: Reading that takes longer is a finding.

    Returns:
        `read` or `refused`, and what went wrong.
    """
    rng = np.random.default_rng((seed, case))
    names = target.write(folder)
    name = names[rng.integers(len(names))]
    how = f"{name}, {damage(folder / name, rng)}"
    before = sorted(folder.rglob("*"))
    started, wrong, outcome = time.perf_counter(), [], "read"
    try:
        with warnings.catch_warnings(), contextlib.redirect_stderr(io.StringIO()):
            warnings.simplefilter("ignore")
            target.read(folder)
    except UserError as error:
        outcome = "refused"
        if not str(error).strip():
            wrong.append("an empty line")
    except Exception:
        wrong.append(traceback.format_exc())
    if (taken := time.perf_counter() - started) > seconds:
        wrong.append(f"took {taken:.1f} s")
    if sorted(folder.rglob("*")) != before:
        wrong.append("files appeared or went")
    return outcome, [Finding(kind, case, how, what) for what in wrong]


def fuzz(
    cases: int, seed: int, targets: dict[str, Target] | None = None, seconds: float = 10.0, keep: Path | None = None
) -> tuple[Counter[tuple[str, str]], list[Finding]]:
    """Run cases, the kinds of files in turn.

    Returns:
        (kind, outcome) to count, and what went wrong. Damaged examples that went wrong are copied to `keep`.
    """
    targets = TARGETS if targets is None else targets
    kinds = list(targets)
    outcomes: Counter[tuple[str, str]] = Counter()
    findings: list[Finding] = []
    for case in range(cases):
        kind = kinds[case % len(kinds)]
        with tempfile.TemporaryDirectory() as folder:
            outcome, wrong = run_case(kind, targets[kind], seed, case, Path(folder), seconds)
            outcomes[kind, "went wrong" if wrong else outcome] += 1
            findings += wrong
            if wrong and keep is not None:
                shutil.copytree(folder, keep / f"{kind}-{case}", dirs_exist_ok=True)
    return outcomes, findings


def _peak() -> float:
    """MiB this process has used at its peak."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def main() -> int:
    """See the module."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", nargs="+", choices=list(TARGETS), help="kinds of files (default: all)")
    parser.add_argument("--keep", type=Path, help="folder for the files that went wrong")
    parser.add_argument("--seconds", type=float, default=10.0, help="that reading one may take (default: 10)")
    parser.add_argument("--memory", type=float, default=1024.0, help="MiB that all may add (default: 1024)")
    arguments = parser.parse_args()
    chosen = {name: TARGETS[name] for name in arguments.only or TARGETS}
    before = _peak()
    outcomes, findings = fuzz(arguments.cases, arguments.seed, chosen, arguments.seconds, arguments.keep)
    added = _peak() - before
    print("| file | read | refused | went wrong |\n|---|---:|---:|---:|")
    for kind in chosen:
        counts = [outcomes[kind, outcome] for outcome in ("read", "refused", "went wrong")]
        print(f"| {kind} | {' | '.join(map(str, counts))} |")
    print(f"\n{arguments.cases} cases with seed {arguments.seed}; memory at its peak {added:.0f} MiB above the start")
    for finding in findings:
        print(f"\n{finding.kind}, case {finding.case}, {finding.how}:\n{finding.what}")
    if added > arguments.memory:
        print(f"\nmore memory than {arguments.memory:.0f} MiB")
    return int(bool(findings) or added > arguments.memory)


if __name__ == "__main__":
    sys.exit(main())
