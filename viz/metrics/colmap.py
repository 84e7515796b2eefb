"""Structure from motion on the pictures: does COLMAP find the cameras that they were made with?

COLMAP is told the intrinsics and finds poses and points from the pictures alone. It runs through pycolmap (the extra
`sfm`) in a process of its own, since it ends the process on some inputs.
"""

from __future__ import annotations

import json
import math
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from PIL import Image

from gazenerf.geometry import Camera
from gazenerf.viz.metrics.definitions import NOT_NEGATIVE, SHARE, Definition
from gazenerf.viz.metrics.tsed import CAMERAS
from gazenerf.viz.pictures.colormaps import to_uint8

WORKER = Path(__file__).with_name("colmap_worker.py")
INSTALL = "pycolmap is not installed: pip install 'gazenerf[sfm]'"
NO_MODEL = "COLMAP found too few matches for a model"
TIMEOUT_S = 600.0
PEAK = 0.001
"""Contrast from which COLMAP takes a feature; a seventh of its default, since skin is smooth."""

TRIALS = 6
"""Reconstructions, from as many seeds; the one with most pictures, then the smallest error, counts.

Under a narrow field of view a head turned inside out and seen from the other side fits nearly as well, and single runs
fall for it."""

MIN_ALIGNED = 3
"""Fewest cameras from which a similarity is found."""

_ADVICE = (
    "Structure from motion finds other cameras than those given: with many matches the pictures are inconsistent, with "
    "few matches COLMAP itself is unsure, so look at TSED first."
)

DEFINITIONS = (
    Definition(
        "sfm_registered", "COLMAP: pictures registered, share", "",
        "The share of the pictures that COLMAP, a structure-from-motion program, can fit into one 3D scene.",
        passes=0.95, warns=0.8, higher_is_better=True, group=CAMERAS, bounds=SHARE, checks=("field", "frames"),
        advice="Some pictures do not fit into one scene with the others, or have too little texture: look at which "
        "pairs have few matches.",
        method="Share of the pictures in COLMAP's largest model.",
    ),
    Definition(
        "sfm_reprojection_px", "COLMAP: reprojection error, mean", "px",
        "How far the 3D points that COLMAP finds land from where the pictures show them.",
        passes=1.0, warns=2.0, group=CAMERAS, bounds=NOT_NEGATIVE, checks=("field", "frames"),
        advice=_ADVICE,
        method="Mean reprojection error of the model's points.",
    ),
    Definition(
        "sfm_position_percent", "COLMAP: camera positions off, of their distance", "%",
        "How far the camera positions that COLMAP finds lie from the given ones, in per cent of the distance to what "
        "they look at.",
        passes=1.5, warns=5.0, group=CAMERAS, bounds=NOT_NEGATIVE, checks=("field", "frames"),
        advice=_ADVICE,
        method="Median distance between the model's camera centres and the given ones after a similarity fit, of "
        "their median distance from the point they look at.",
    ),
    Definition(
        "sfm_turn_deg", "COLMAP: cameras turned", "deg",
        "By how much the cameras that COLMAP finds are turned against the given ones.",
        passes=1.0, warns=3.0, group=CAMERAS, bounds=NOT_NEGATIVE, checks=("field", "frames"),
        advice=_ADVICE,
        method="Median angle between the model's cameras and the given ones after that fit.",
    ),
)  # fmt: skip
"""Structure from motion."""


@dataclass(frozen=True)
class StructureFromMotion:
    """What COLMAP made of a set of pictures.

    Attributes:
        pictures, registered: How many were given, and how many of them its largest model holds.
        points: In space.
        reprojection_px: Mean over the points of their mean reprojection error.
        position_percent: Median distance between found and given camera centres after a similarity fit, in per cent of
            the median distance of the given centres from their middle of attention.
        turn_deg: Median angle between found and given camera axes after the fit.
        reason: Why nothing was found; empty otherwise.
    """

    pictures: int
    registered: int = 0
    points: int = 0
    reprojection_px: float = math.nan
    position_percent: float = math.nan
    turn_deg: float = math.nan
    reason: str = ""


def unavailable() -> str | None:
    """Why COLMAP cannot run here, with the fix; None when it can."""
    return None if find_spec("pycolmap") else INSTALL


def run_colmap(
    images: Sequence[np.ndarray], cameras: Sequence[Camera], *, seed: int = 0, timeout_s: float = TIMEOUT_S
) -> StructureFromMotion:
    """Reconstruct from pictures and compare the cameras found with those given.

    Args:
        images: (H, W, 3) sRGB, uint8 or in [0, 1].
        cameras: One per picture; their intrinsics are given to COLMAP, their poses are not.
        seed: Of COLMAP's random choices.
        timeout_s: The process is ended after this many seconds.
    """
    if (reason := unavailable()) is not None:
        return StructureFromMotion(len(images), reason=reason)
    with tempfile.TemporaryDirectory(prefix="gazenerf-sfm-") as name:
        folder = Path(name)
        (folder / "images").mkdir()
        for i, image in enumerate(images):
            Image.fromarray(to_uint8(image)).save(folder / "images" / f"{i:05d}.png")
        lenses = [[c.fx, c.fy, c.cx, c.cy] for c in cameras]
        task = {"lenses": lenses, "seed": seed, "trials": TRIALS, "peak": PEAK, "least": MIN_ALIGNED}
        (folder / "task.json").write_text(json.dumps(task))
        try:
            done = subprocess.run(
                [sys.executable, "-P", str(WORKER), str(folder)],
                capture_output=True,
                text=True,
                timeout=timeout_s,
                check=False,
            )
        except subprocess.TimeoutExpired:
            return StructureFromMotion(len(images), reason=f"COLMAP did not end within {timeout_s:g} s")
        answer = folder / "answer.json"
        if done.returncode != 0 or not answer.is_file():
            spoken = done.stderr.strip().splitlines() or [f"it ended with code {done.returncode}"]
            return StructureFromMotion(len(images), reason=f"COLMAP failed: {spoken[-1].strip()[:160]}")
        found = json.loads(answer.read_text())
    if not found["poses"]:
        return StructureFromMotion(len(images), reason=NO_MODEL)
    indices = [int(i) for i in found["poses"]]
    theirs = np.array(list(found["poses"].values()))
    shift, turn = _camera_errors([cameras[i] for i in indices], theirs, cameras)
    return StructureFromMotion(len(images), len(indices), found["points"], found["reprojection_px"], shift, turn)


def similarity(found: np.ndarray, given: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Scale, rotation (3, 3) and translation (3,) that lay camera poses (N, 4, 4) on others, not mirrored.

    The rotation is the chordal mean of the cameras' own (Hartley et al. 2013), scale and translation are least squares
    on the centres: centres alone, along a short arc, leave the turn about it open.
    """
    u, _, vt = np.linalg.svd(np.einsum("nij,nkj->ik", given[:, :3, :3], found[:, :3, :3]))
    rotation = (u * [1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    moving, fixed = found[:, :3, 3] @ rotation.T, given[:, :3, 3]
    m, f = moving - moving.mean(axis=0), fixed - fixed.mean(axis=0)
    scale = float((m * f).sum() / max((m**2).sum(), 1e-300))
    return scale, rotation, fixed.mean(axis=0) - scale * moving.mean(axis=0)


def middle_of_attention(cameras: Sequence[Camera]) -> np.ndarray:
    """(3,) the point nearest to all optical axes; far away or arbitrary along them where they are parallel."""
    axes = np.array([camera.world_from_camera[:3, 2] for camera in cameras])
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    centres = np.array([camera.position for camera in cameras])
    return np.linalg.lstsq(across.sum(axis=0), np.einsum("nij,nj->i", across, centres), rcond=None)[0]


def _camera_errors(given: Sequence[Camera], found: np.ndarray, everyone: Sequence[Camera]) -> tuple[float, float]:
    """Median position error in per cent and median turn in degrees; `found` (N, 4, 4) is world from camera."""
    if len(given) < MIN_ALIGNED:
        return math.nan, math.nan
    truth = np.array([camera.world_from_camera for camera in given])
    scale, rotation, shift = similarity(found, truth)
    off = np.linalg.norm(scale * found[:, :3, 3] @ rotation.T + shift - truth[:, :3, 3], axis=1)
    reach = np.linalg.norm(truth[:, :3, 3] - middle_of_attention(everyone), axis=1)
    traces = np.einsum("nij,nij->n", rotation @ found[:, :3, :3], truth[:, :3, :3])
    angles = np.degrees(np.arccos(np.clip(0.5 * (traces - 1.0), -1.0, 1.0)))
    return float(100.0 * np.median(off) / np.median(reach)), float(np.median(angles))
