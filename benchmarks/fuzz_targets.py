"""Small sound examples of every kind of file that is read from strangers, and how each is read."""

from __future__ import annotations

import argparse
import json
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image

from benchmarks.fuzz_datasets import (
    read_dataset_hdf5,
    read_dataset_photographs,
    write_dataset_hdf5,
    write_dataset_photographs,
)
from benchmarks.fuzz_texts import read_reports, read_some_options, write_options, write_reports
from gazenerf.baselines.sted.checkpoint import load_sted, save_sted
from gazenerf.baselines.sted.config import StedConfig
from gazenerf.baselines.sted.network import Sted
from gazenerf.checkpoints import import_official, load_field, save_field
from gazenerf.data import CaptureSet
from gazenerf.data.captures import Capture
from gazenerf.data.storage import write_manifest, write_shard
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


def _sted(folder: Path) -> list[str]:
    torch.manual_seed(0)
    config = StedConfig(image_size=16, growth=1, layers=1, appearance=4, one_d=1, two_d=2, width=2)
    save_sted(Sted(config), folder / "sted.safetensors")
    return ["sted.safetensors"]


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
    "sted": Target(_sted, _each(load_sted, "sted.safetensors")),
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
    "report": Target(write_reports, read_reports),
    "options": Target(write_options, read_some_options),
    "dataset-hdf5": Target(write_dataset_hdf5, read_dataset_hdf5),
    "dataset-photographs": Target(write_dataset_photographs, read_dataset_photographs),
}
"""Kind of file to how it is written and read."""
