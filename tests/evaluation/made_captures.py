"""Captures of a flat head with an eye, for tests of redirections."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from gazenerf.data.captures import Capture
from gazenerf.data.storage import write_manifest, write_shard
from gazenerf.geometry import Camera, Gaze
from gazenerf.subjects import Codes

SIZE = 48


def flat_capture(person: int, view: int, **changes) -> Capture:
    """A grey square with a bright eye before black; every capture has its own gaze, camera and light."""
    parts = np.zeros((SIZE, SIZE), np.uint8)
    parts[8:40, 8:40] = 1
    parts[18:24, 14:22] = 2
    image = np.full((SIZE, SIZE, 3), 128, np.uint8) * (parts > 0)[..., None].astype(np.uint8)
    codes = Codes(np.full(2, person), np.full(2, view), np.full(2, 10 + person), np.full(27, view))
    camera, gaze = Camera.orbit(0.1 * view, 0.02 * person, size=SIZE), Gaze(0.01 * view, 0.02 * person)
    made = Capture(image, parts, np.where(parts > 0, 12.0, 0.0).astype(np.float32), camera, gaze, codes, person, view)
    return replace(made, **changes)


def write_captures(folder: Path, gaze: Gaze | None = None) -> Path:
    """Three people, six views each; the last person looks elsewhere where a gaze is given."""
    write_manifest(folder, {"code_sizes": [2, 2, 2, 27]})
    for person in range(3):
        captures = [flat_capture(person, view) for view in range(6)]
        if gaze is not None and person == 2:
            captures = [replace(capture, gaze=gaze) for capture in captures]
        write_shard(folder, captures)
    return folder
