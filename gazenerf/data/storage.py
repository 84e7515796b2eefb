"""Captures on disk: a manifest and one shard a person and range of views, written whole, no pickle.

A shard is a `.npz` whose pictures are PNG bytes; a folder can be extended or resumed shard by shard.
"""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from gazenerf.data.captures import Capture
from gazenerf.errors import UserError
from gazenerf.files import whole_file
from gazenerf.geometry import Camera, Gaze
from gazenerf.subjects import Codes

FORMAT = "gazenerf-captures-1"
MANIFEST = "manifest.json"
SHARD_VIEWS = 30
MAX_SIDE = 4096
MAX_SHARD_BYTES = 2**30
DEPTH_STEP = 5e-4
"""World units a depth level; depth is stored as 16-bit steps from the capture's nearest point."""


def shard_name(person: int, first_view: int) -> str:
    """File name of a shard."""
    return f"person-{person:04d}-view-{first_view:05d}.npz"


def write_manifest(folder: Path, manifest: dict[str, Any]) -> None:
    """Write a set's manifest, adding the format.

    Raises:
        UserError: the folder already holds another set.
    """
    path = folder / MANIFEST
    manifest = {"format": FORMAT, **manifest}
    if path.is_file():
        if json.loads(path.read_text()) != manifest:
            raise UserError(f"{folder} holds other captures; choose another --out or the same settings to resume")
        return
    with whole_file(path) as temporary:
        temporary.write_text(json.dumps(manifest, indent=2) + "\n")


def write_shard(folder: Path, captures: list[Capture]) -> None:
    """Write captures of one person as a shard named after the first one's view."""
    arrays: dict[str, np.ndarray] = {
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
        "identity": np.stack([c.codes.identity for c in captures]),
        "expression": np.stack([c.codes.expression for c in captures]),
        "texture": np.stack([c.codes.texture for c in captures]),
        "illumination": np.stack([c.codes.illumination for c in captures]),
    }
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


class CaptureSet:
    """A folder of captures, read shard by shard and kept in memory once read.

    Args:
        folder: What `gazenerf synthesize` wrote.

    Raises:
        UserError: no manifest, another format, or a damaged shard.
    """

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)
        path = self.folder / MANIFEST
        if not path.is_file():
            raise UserError(f"no captures in {self.folder}; make some with `gazenerf synthesize --out {self.folder}`")
        try:
            self.manifest: dict[str, Any] = json.loads(path.read_text())
        except (OSError, ValueError) as error:
            raise UserError(f"cannot read {path}: {error}") from error
        if not isinstance(self.manifest, dict) or self.manifest.get("format") != FORMAT:
            raise UserError(f"{path} is not a manifest of captures")
        self._captures: list[Capture] = []
        for shard in sorted(self.folder.glob("person-*.npz")):
            self._captures += read_shard(shard)
        if not self._captures:
            raise UserError(f"{self.folder} holds a manifest but no shards; run `gazenerf synthesize` again")

    def __len__(self) -> int:
        return len(self._captures)

    def __getitem__(self, index: int) -> Capture:
        return self._captures[index]

    @property
    def people(self) -> list[int]:
        """Indices of the people, ascending."""
        return sorted({capture.person for capture in self._captures})


def read_shard(path: Path) -> list[Capture]:
    """The captures of one shard.

    Raises:
        UserError: too large, damaged, or not a shard.
    """
    if path.stat().st_size > MAX_SHARD_BYTES:
        raise UserError(f"{path} is larger than a shard can be")
    try:
        with np.load(path, allow_pickle=False) as file:
            meta = json.loads(file["meta"].tobytes())
            codes = [file[name] for name in ("identity", "expression", "texture", "illumination")]
            out = []
            for i, about in enumerate(meta):
                image, parts = _read_png(file[f"image_{i}"]), _read_png(file[f"parts_{i}"])
                steps = _read_png(file[f"depth_{i}"]).astype(np.float64)
                depth = np.where(steps > 0, float(file[f"near_{i}"]) + (steps - 1) * DEPTH_STEP, 0.0)
                camera = Camera.from_dict(about["camera"])
                if image.shape != (camera.height, camera.width, 3) or parts.shape != image.shape[:2] != depth.shape:
                    raise ValueError("picture, parts, depth and camera differ in size")
                gaze = Gaze(float(about["gaze"][0]), float(about["gaze"][1]))
                out.append(
                    Capture(image, parts, depth.astype(np.float32), camera, gaze, Codes(*(c[i] for c in codes)),
                            int(about["person"]), int(about["view"]))
                )  # fmt: skip
            return out
    except (OSError, KeyError, ValueError, IndexError, TypeError, SyntaxError) as error:
        raise UserError(f"cannot read the shard {path}: {error}; delete it and synthesize again") from error


def _read_png(data: np.ndarray) -> np.ndarray:
    with Image.open(io.BytesIO(data.tobytes()), formats=["PNG"]) as image:
        if max(image.size) > MAX_SIDE:
            raise ValueError(f"a picture of {image.size[0]}x{image.size[1]} pixels")
        return np.array(image)
