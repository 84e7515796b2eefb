"""COLMAP models are read like any other cameras, and damaged ones refused."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from gazenerf.errors import UserError
from gazenerf.export.formats.dataset_cameras import SeenPoints, colmap_model
from gazenerf.viz.check.frames import read_frames
from tests.viz.check.frame_folders import CAMERAS, agrees, scene


def colmap_folder(folder: Path, kind: str) -> None:
    """The scene as COLMAP has it, its model as text or binary."""
    scene(folder)
    (folder / "transforms.json").unlink()
    model = folder / "sparse" / "0"
    model.mkdir(parents=True)
    nothing = SeenPoints(np.zeros((2, 2)), np.zeros((2, 3)), np.zeros((2, 3), np.uint8))
    texts = colmap_model(CAMERAS, [f"{i}.png" for i in range(3)], [nothing] * 3)
    if kind == "txt":
        for name, text in texts.items():
            (model / name).write_text(text)
        return
    cameras = [line.split() for line in texts["cameras.txt"].splitlines() if not line.startswith("#")]
    packed = struct.pack("<Q", len(cameras))
    for number, _, width, height, *values in cameras:
        packed += struct.pack("<iiQQ4d", int(number), 1, int(width), int(height), *map(float, values))
    (model / "cameras.bin").write_bytes(packed)
    images = [line for line in texts["images.txt"].splitlines() if not line.startswith("#")][::2]
    packed = struct.pack("<Q", len(images))
    for words in map(str.split, images):
        packed += struct.pack("<i7di", int(words[0]), *map(float, words[1:8]), int(words[8]))
        packed += words[9].encode() + b"\0" + struct.pack("<Q", 2) + bytes(48)
    (model / "images.bin").write_bytes(packed)


@pytest.mark.parametrize("kind", ["txt", "bin"])
def test_colmap_models_are_read(tmp_path, kind):
    colmap_folder(tmp_path, kind)
    folder = read_frames(tmp_path)
    assert [frame.name for frame in folder.frames] == ["0.png", "1.png", "2.png"]
    for mine, theirs in zip(folder.cameras, CAMERAS, strict=True):
        assert mine.world_from_camera == pytest.approx(theirs.world_from_camera, abs=1e-6)
        assert mine.intrinsics == pytest.approx(theirs.intrinsics)
    assert all(agrees(folder, i) for i in range(3))


@pytest.mark.parametrize("kind", ["txt", "bin"])
def test_damaged_colmap_models_are_one_line(tmp_path, kind):
    colmap_folder(tmp_path, kind)
    for name in ("cameras", "images"):
        file = tmp_path / "sparse" / "0" / f"{name}.{kind}"
        whole = file.read_bytes()
        for damage in (whole[: len(whole) // 2 - 3], whole[:9], b"\xff" * 200, whole[:8] + b"\xff" * len(whole)):
            file.write_bytes(damage)
            with pytest.raises(UserError) as caught:
                read_frames(tmp_path)
            assert "\n" not in str(caught.value)
        file.write_bytes(whole)
