"""A COLMAP model's cameras and images, from text or binary files, as the frames of a transforms.json.

Files are untrusted: they are bounded, and counts in them are believed only as far as the file reaches.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from gazenerf.errors import UserError
from gazenerf.geometry.cameras import OPENGL_FROM_OPENCV

MAX_BYTES = 2**30
MODELS: dict[int, tuple[str, tuple[str, ...]]] = {
    0: ("SIMPLE_PINHOLE", ("f", "cx", "cy")),
    1: ("PINHOLE", ("fl_x", "fl_y", "cx", "cy")),
    2: ("SIMPLE_RADIAL", ("f", "cx", "cy", "k1")),
    3: ("RADIAL", ("f", "cx", "cy", "k1", "k2")),
    4: ("OPENCV", ("fl_x", "fl_y", "cx", "cy", "k1", "k2", "p1", "p2")),
    5: ("OPENCV_FISHEYE", ("fl_x", "fl_y", "cx", "cy", "k1", "k2", "k3", "k4")),
}
"""COLMAP's number of a camera model to its name and parameters, in COLMAP's order."""


class _Image(NamedTuple):
    rotation: tuple[float, ...]
    """w, x, y, z, camera from world."""
    shift: tuple[float, ...]
    camera: int
    name: str


def model_folder(folder: Path) -> Path | None:
    """Where the model of a folder lies: `sparse/0`, `sparse` or the folder itself; None where there is none."""
    for place in (folder / "sparse" / "0", folder / "sparse", folder / "colmap" / "sparse" / "0", folder):
        if any((place / f"images.{kind}").is_file() for kind in ("bin", "txt")):
            return place
    return None


def colmap_frames(folder: Path) -> list[dict[str, Any]]:
    """The frames of a model, by name, each as in a transforms.json: intrinsics, distortion, pose with OpenGL axes.

    Args:
        folder: Holds cameras and images, `.bin` or `.txt`.

    Raises:
        UserError: missing, damaged, too large, or of a camera model that is not read.
    """
    kind = "bin" if (folder / "images.bin").is_file() else "txt"
    try:
        if kind == "bin":
            cameras = _binary_cameras(_read(folder / "cameras.bin"))
            images = list(_binary_images(_read(folder / "images.bin")))
        else:
            cameras = _text_cameras(_read(folder / "cameras.txt").decode("utf-8"))
            images = list(_text_images(_read(folder / "images.txt").decode("utf-8")))
        frames = [_frame(image, cameras[image.camera]) for image in images]
    except (OSError, ValueError, KeyError, IndexError, struct.error) as error:
        raise UserError(
            f"the COLMAP model {folder} cannot be read: {type(error).__name__} {str(error)[:100]}"
        ) from error
    return sorted(frames, key=lambda frame: frame["file_path"])


def _read(file: Path) -> bytes:
    if file.stat().st_size > MAX_BYTES:
        raise ValueError(f"{file.name} is larger than {MAX_BYTES >> 20} MiB")
    return file.read_bytes()


def _camera(model: str, width: int, height: int, values: tuple[float, ...]) -> dict[str, Any]:
    keys = dict(MODELS.values()).get(model)
    if keys is None:
        known = ", ".join(name for name, _ in MODELS.values())
        raise ValueError(f"a {model[:40]} camera; read are {known}")
    if len(values) != len(keys):
        raise ValueError(f"a {model} camera of {len(values)} parameters where {len(keys)} are due")
    found = dict(zip(keys, values, strict=True))
    if "f" in found:
        found["fl_x"] = found["fl_y"] = found.pop("f")
    return {"camera_model": model, "w": width, "h": height, **found}


def _frame(image: _Image, camera: dict[str, Any]) -> dict[str, Any]:
    w, x, y, z = image.rotation
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_quat((x, y, z, w)).as_matrix().T
    pose[:3, 3] = -pose[:3, :3] @ np.array(image.shift)
    return camera | {"file_path": image.name, "transform_matrix": (pose @ OPENGL_FROM_OPENCV).tolist()}


def _rows(text: str) -> Iterator[str]:
    return (line for line in text.splitlines() if not line.startswith("#"))


def _text_cameras(text: str) -> dict[int, dict[str, Any]]:
    found = {}
    for line in _rows(text):
        if words := line.split():
            found[int(words[0])] = _camera(words[1], int(words[2]), int(words[3]), tuple(map(float, words[4:])))
    return found


def _text_images(text: str) -> Iterator[_Image]:
    """Every other line is an image; the lines between list the points that it sees and may be empty."""
    for line in list(_rows(text))[::2]:
        if words := line.split(maxsplit=9):
            numbers = tuple(map(float, words[1:8]))
            yield _Image(numbers[:4], numbers[4:], int(words[8]), words[9].strip())


def _binary_cameras(data: bytes) -> dict[int, dict[str, Any]]:
    (count,), place, found = struct.unpack_from("<Q", data), 8, {}
    for _ in range(min(count, len(data))):
        number, model, width, height = struct.unpack_from("<iiQQ", data, place)
        if model not in MODELS:
            raise ValueError(f"a camera of COLMAP's model {model}")
        name, keys = MODELS[model]
        found[number] = _camera(name, width, height, struct.unpack_from(f"<{len(keys)}d", data, place + 24))
        place += 24 + 8 * len(keys)
    return found


def _binary_images(data: bytes) -> Iterator[_Image]:
    (count,), place = struct.unpack_from("<Q", data), 8
    for _ in range(min(count, len(data))):
        _, *numbers, camera = struct.unpack_from("<i7di", data, place)
        end = data.index(b"\0", place + 64)
        name = data[place + 64 : end].decode("utf-8")
        (points,) = struct.unpack_from("<Q", data, end + 1)
        place = end + 9 + 24 * points
        if place > len(data):
            raise ValueError("an image sees more points than the file holds")
        yield _Image(tuple(numbers[:4]), tuple(numbers[4:]), camera, name)
