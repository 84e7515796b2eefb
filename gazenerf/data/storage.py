"""Captures on disk: a manifest, and shards that each hold a range of one person's views, written whole, without pickle.

A shard is a `.npz` whose pictures are PNG bytes; a folder is resumed shard by shard.
"""

from __future__ import annotations

import io
import json
import math
import struct
import zipfile
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, overload

import numpy as np
from PIL import Image

from gazenerf.data.arrays import read_stored_arrays
from gazenerf.data.captures import Capture
from gazenerf.errors import UserError
from gazenerf.files import parse_json, whole_file
from gazenerf.folders import Folder, local_copy
from gazenerf.geometry import Camera, Gaze
from gazenerf.progress import Progress, silent
from gazenerf.subjects import CODES, HAIR, Codes

FORMAT = "gazenerf-captures-1"
MANIFEST = "manifest.json"
SHARD_VIEWS = 30
MAX_SIDE = 4096
MAX_SHARD_BYTES = 2**30
MAX_MANIFEST_BYTES = 2**20
DEPTH_STEP = 5e-4
"""World units per depth level; depth is stored as 16-bit steps from the capture's nearest point."""

EARLIER = {"expressions": "few", "hair": "none"}
"""What holds for sets whose manifests are older than a setting."""

_DAMAGE = (
    OSError, EOFError, KeyError, ValueError, IndexError, TypeError, AttributeError, SyntaxError, OverflowError,
    RecursionError, MemoryError, NotImplementedError, struct.error, zlib.error, zipfile.BadZipFile,
    Image.DecompressionBombError,
)  # fmt: skip
"""What reading a damaged shard can raise."""


def shard_name(person: int, first_view: int) -> str:
    """File name of a shard."""
    return f"person-{person:04d}-view-{first_view:05d}.npz"


def write_manifest(folder: Folder, manifest: dict[str, Any]) -> None:
    """Write a set's manifest, adding the format.

    Raises:
        UserError: the folder already holds another set; the message says what differs.
    """
    path = folder / MANIFEST
    manifest = {"format": FORMAT, **manifest}
    if path.is_file():
        old, manifest = read_manifest(folder), EARLIER | manifest
        differing = [key for key in sorted(old.keys() | manifest.keys()) if old.get(key) != manifest.get(key)]
        if differing:
            shared = [key for key in differing if key in old and key in manifest] or differing
            changes = "; ".join(f"{key} {old.get(key)}, not {manifest.get(key)}" for key in shared)
            raise UserError(
                f"{folder} holds other captures ({changes}); choose another --out or the same settings to resume"
            )
        return
    with whole_file(path) as temporary:
        temporary.write_text(json.dumps(manifest, indent=2) + "\n")


def read_manifest(folder: Folder) -> dict[str, Any]:
    """A set's manifest, with what holds for an older one that lacks a setting.

    Raises:
        UserError: it is missing, too large, damaged, or of another format.
    """
    path = folder / MANIFEST
    if not path.is_file():
        raise UserError(f"no captures in {folder}; make some with `gazenerf synthesize --out {folder}`")
    try:
        if path.stat().st_size > MAX_MANIFEST_BYTES:
            raise ValueError("it is too large")
        manifest = parse_json(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise UserError(f"cannot read {path}: {error}") from error
    if not isinstance(manifest, dict) or manifest.get("format") != FORMAT:
        raise UserError(f"{path} is not a manifest of captures")
    return EARLIER | manifest


def write_shard(folder: Folder, captures: list[Capture]) -> None:
    """Write captures of one person as a shard named after the first one's view."""
    arrays: dict[str, Any] = {
        "meta": np.frombuffer(
            json.dumps(
                [
                    {
                        "camera": c.camera.to_dict(),
                        "gaze": [c.gaze.pitch, c.gaze.yaw],
                        "person": c.person,
                        "view": c.view,
                    }
                    for c in captures
                ]
            ).encode(),
            dtype=np.uint8,
        ),
    }
    for name in CODES:
        arrays[name] = np.stack([getattr(c.codes, name) for c in captures])
    if captures[0].codes.hair.size:
        arrays[HAIR] = np.stack([c.codes.hair for c in captures])
    for i, capture in enumerate(captures):
        seen = capture.depth > 0
        nearest = float(capture.depth[seen].min()) if seen.any() else 0.0
        steps = np.where(seen, np.round((capture.depth - nearest) / DEPTH_STEP) + 1, 0)
        arrays[f"near_{i}"] = np.float64(nearest)
        arrays[f"image_{i}"] = _png(capture.image)
        arrays[f"parts_{i}"] = _png(capture.parts)
        arrays[f"depth_{i}"] = _png(np.clip(steps, 0, 65535).astype(np.uint16))
    with whole_file(folder / shard_name(captures[0].person, captures[0].view)) as temporary:
        np.savez(temporary, **arrays)


def _png(image: np.ndarray) -> np.ndarray:
    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, format="png", compress_level=6)
    return np.frombuffer(buffer.getvalue(), dtype=np.uint8)


class CaptureSet(Sequence[Capture]):
    """A folder of captures, read shard by shard and kept in memory once read.

    Args:
        folder: What `gazenerf synthesize` wrote; of a URL a copy is made, see `gazenerf.folders.local_copy`.
        progress: Told about files that are fetched.

    Attributes:
        folder: Of this machine.

    Raises:
        UserError: no manifest, another format, a damaged shard, or a URL from which nothing can be fetched.
    """

    def __init__(self, folder: str | Path | Folder, progress: Progress = silent) -> None:
        self.folder = local_copy(folder, progress)
        self.manifest = read_manifest(self.folder)
        self._captures: list[Capture] = []
        for shard in sorted(self.folder.glob("person-*.npz")):
            captures = read_shard(shard)
            if any(list(capture.codes.sizes) != self.manifest.get("code_sizes") for capture in captures):
                raise UserError(f"the codes in {shard} are not of the sizes in {MANIFEST}; it belongs to another set")
            self._captures += captures
        if not self._captures:
            raise UserError(f"{self.folder} holds a manifest but no shards; run `gazenerf synthesize` again")

    def __len__(self) -> int:
        return len(self._captures)

    @overload
    def __getitem__(self, index: int) -> Capture: ...
    @overload
    def __getitem__(self, index: slice) -> list[Capture]: ...
    def __getitem__(self, index: int | slice) -> Capture | list[Capture]:
        return self._captures[index]

    @property
    def people(self) -> list[int]:
        """Indices of the people, ascending."""
        return sorted({capture.person for capture in self._captures})


def read_shard(path: Path) -> list[Capture]:
    """The captures of one shard.

    Sizes are checked before anything is unpacked, and nothing in the file is executed.

    Raises:
        UserError: missing, too large, damaged, or not a shard.
    """
    try:
        if path.stat().st_size > MAX_SHARD_BYTES:
            raise ValueError("it is larger than a shard can be")
        arrays = read_stored_arrays(path, most=6 + 4 * SHARD_VIEWS)
        meta = parse_json(arrays["meta"].tobytes())
        if not isinstance(meta, list) or len(meta) > SHARD_VIEWS:
            raise ValueError(f"it does not describe up to {SHARD_VIEWS} captures")
        return [_capture(arrays, i, about) for i, about in enumerate(meta)]
    except _DAMAGE as error:
        reason = " ".join(f"{type(error).__name__}: {error}".split())[:200]
        raise UserError(f"cannot read the shard {path} ({reason}); delete it and synthesize again") from error


def _capture(arrays: dict[str, np.ndarray], i: int, about: dict[str, Any]) -> Capture:
    camera, gaze = Camera.from_dict(about["camera"]), Gaze(float(about["gaze"][0]), float(about["gaze"][1]))
    nearest = float(arrays[f"near_{i}"])
    numbers = (camera.fx, camera.fy, camera.cx, camera.cy, gaze.pitch, gaze.yaw, nearest)
    if not all(math.isfinite(number) for number in numbers) or nearest < 0:
        raise ValueError("a camera, gaze or depth is not a possible number")
    size = camera.width, camera.height
    image = _read_png(arrays[f"image_{i}"], size, ("RGB",))
    parts = _read_png(arrays[f"parts_{i}"], size, ("L",))
    steps = _read_png(arrays[f"depth_{i}"], size, ("I;16", "I")).astype(np.float64)
    if parts.max() > 3:
        raise ValueError("a part id is above 3")
    depth = np.where(steps > 0, nearest + (steps - 1) * DEPTH_STEP, 0.0).astype(np.float32)
    hair = {HAIR: arrays[HAIR][i]} if HAIR in arrays else {}
    codes = Codes(*(arrays[name][i] for name in CODES), **hair)
    return Capture(image, parts, depth, camera, gaze, codes, int(about["person"]), int(about["view"]))


def _read_png(data: np.ndarray, size: tuple[int, int], modes: tuple[str, ...]) -> np.ndarray:
    with Image.open(io.BytesIO(data.tobytes()), formats=["PNG"]) as image:
        if image.size != size or max(size) > MAX_SIDE or image.mode not in modes:
            raise ValueError(f"a {image.mode} picture of {image.size[0]}x{image.size[1]} pixels")
        return np.array(image)
