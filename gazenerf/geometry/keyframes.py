"""Camera paths through keyframes that a user writes in a JSON file.

The file holds `{"loop": true, "keyframes": [...]}`. Each key places a camera in one of three ways,
angles in degrees, lengths in world units:

- `{"yaw": 30, "pitch": 10, "distance": 12, "target": [0, 0, 0]}`: on a sphere about the target;
- `{"position": [0, 0, 12], "target": [0, 0, 0]}`: anywhere, looking at the target;
- `{"world_from_camera": [[...], [...], [...], [...]]}`: a rigid (4, 4) transform, OpenCV camera axes.

Every key may also give `fov` (horizontal, degrees) and `time` (any increasing number; keys are one
apart by default). A loop returns to the first key, one more average interval after the last.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.spatial.transform import Rotation, RotationSpline

from gazenerf.errors import UserError
from gazenerf.files import read_json
from gazenerf.geometry.cameras import NEUTRAL_DISTANCE, NEUTRAL_FOV, Camera
from gazenerf.geometry.paths import check_frames

MAX_BYTES = 2**24

LARGEST_STEP = float(np.deg2rad(175.0))
"""Neighbouring keys must turn less than this, radians: half a turn has no shortest way."""

MOST_KEYS = 10_000


@dataclass(frozen=True)
class Keyframe:
    """One camera to pass through.

    Attributes:
        time: When, in any unit.
        camera: Where; only its pose and field of view count.
        target: (3,) a point on the optical axis that the camera turns about, world units.
        level: Whether the image's horizon is to stay level on the way (false for free poses).
    """

    time: float
    camera: Camera
    target: np.ndarray
    level: bool = True

    @property
    def distance(self) -> float:
        """World units from the camera to the target."""
        return float(np.linalg.norm(self.camera.position - self.target))

    @property
    def fov(self) -> float:
        """Horizontal field of view, radians."""
        return float(2.0 * np.arctan(0.5 * self.camera.width / self.camera.fx))


def read_keyframes(path: str | Path, fov: float = NEUTRAL_FOV) -> tuple[list[Keyframe], bool]:
    """The keys of a file, and whether they close into a loop.

    Args:
        path: The JSON file.
        fov: Field of view of the keys that give none, radians.

    Raises:
        UserError: missing, not JSON, or a key that places no camera; the message names the key.
    """
    path = Path(path)
    data = read_json(path, MAX_BYTES, absent="give a JSON file of keyframes", large="no path needs so much")
    return keyframes_of(data, str(path), fov)


def keyframes_of(data: Any, source: str, fov: float = NEUTRAL_FOV) -> tuple[list[Keyframe], bool]:
    """The keys that a keyframe file holds, and whether they close into a loop.

    Args:
        data: The file's JSON.
        source: What messages call it.
        fov: Field of view of the keys that give none, radians.

    Raises:
        UserError: a key that places no camera, or too few of them; the message names the key.
    """
    keys = data.get("keyframes") if isinstance(data, dict) else data
    if not isinstance(keys, list) or not 2 <= len(keys) <= MOST_KEYS:
        raise UserError(f'{source} needs a list "keyframes" of 2 to {MOST_KEYS} cameras')
    parsed = []
    for index, key in enumerate(keys):
        try:
            parsed.append(_parse(key, index, fov))
        except (KeyError, TypeError, ValueError) as error:
            raise UserError(
                f"keyframe {index} of {source}: {error}; give yaw and pitch, or position, or world_from_camera"
            ) from error
    if any(b.time <= a.time for a, b in pairwise(parsed)):
        raise UserError(f"{source}: the times of the keyframes must increase")
    return parsed, bool(data.get("loop", True)) if isinstance(data, dict) else True


def keyframe_path(
    keys: list[Keyframe], frames: int, *, loop: bool = True, size: int | tuple[int, int] = 256
) -> list[Camera]:
    """Cameras on a smooth path through keys.

    View directions follow a rotation spline; targets, distances and fields of view a monotone cubic,
    which does not overshoot, so the camera moves on arcs about its target and comes no closer than
    the keys say.

    Args:
        keys: At least two, times increasing.
        frames: Number of cameras. An open path begins on the first key and ends on the last; a loop
            leaves out its end, which is its beginning.
        loop: Return to the first key.
        size: Image size, one number or (width, height).

    Raises:
        UserError: no frames, fewer than two keys, or neighbours that turn by half a turn.
    """
    check_frames(frames)
    if len(keys) < 2:
        raise UserError("a keyframe path needs at least two keyframes")
    times = np.array([key.time for key in keys])
    rotations = np.stack([key.camera.world_from_camera[:3, :3] for key in keys])
    values = np.stack([np.array([*key.target, key.distance, key.fov]) for key in keys])
    span = period = times[-1] - times[0]
    if loop and not (np.allclose(rotations[0], rotations[-1]) and np.allclose(values[0], values[-1])):
        period = span * len(keys) / (len(keys) - 1)
        times = np.append(times, times[0] + period)
        rotations, values = np.concatenate([rotations, rotations[:1]]), np.concatenate([values, values[:1]])
    steps = (Rotation.from_matrix(rotations[:-1]).inv() * Rotation.from_matrix(rotations[1:])).magnitude()
    if steps.max() > LARGEST_STEP:
        at, turn = int(steps.argmax()), np.rad2deg(steps.max())
        raise UserError(f"keyframes {at} and {(at + 1) % len(keys)} turn by {turn:.0f} degrees; put one between them")
    wanted = times[0] + span * np.linspace(0.0, 1.0, frames)
    if loop:  # the splines see neighbouring laps, so speed and bend agree where the loop closes
        wanted = times[0] + period * np.arange(frames) / frames
        reach = int(np.ceil(12 / (len(times) - 1)))
        laps = np.arange(-reach, reach + 1)
        times = np.concatenate([times[:-1] + lap * period for lap in laps])
        rotations, values = np.tile(rotations[:-1], (len(laps), 1, 1)), np.tile(values[:-1], (len(laps), 1))
    turned = RotationSpline(times, Rotation.from_matrix(rotations))(wanted).as_matrix()
    moved = PchipInterpolator(times, values)(wanted)
    level = all(key.level for key in keys)
    return [_camera(rotation, value, level, size) for rotation, value in zip(turned, moved, strict=True)]


def _camera(rotation: np.ndarray, value: np.ndarray, level: bool, size: int | tuple[int, int]) -> Camera:
    target, distance, fov = value[:3], value[3], value[4]
    position = target - distance * rotation[:, 2]
    if level:
        return Camera.look_at(position, target, size=size, fov=fov)
    width, height = (size, size) if isinstance(size, int) else size
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, position
    focal = float(0.5 * width / np.tan(0.5 * fov))
    return Camera(focal, focal, width / 2.0, height / 2.0, width, height, pose)


def _vector(value: Any) -> np.ndarray:
    vector = np.asarray(value, dtype=np.float64)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise ValueError(f"expected three numbers, got {value!r}")
    return vector


def _parse(key: Any, index: int, fov: float) -> Keyframe:
    if not isinstance(key, dict):
        raise TypeError(f"expected an object, got {key!r}")
    time = float(key.get("time", index))
    fov = float(np.deg2rad(float(key["fov"]))) if "fov" in key else fov
    if not (np.isfinite(time) and 0.0 < fov < np.pi):
        raise ValueError("time must be finite and fov between 0 and 180 degrees")
    if "world_from_camera" in key:
        pose = np.asarray(key["world_from_camera"], dtype=np.float64)
        focal = float(0.5 / np.tan(0.5 * fov))
        camera = Camera(focal, focal, 0.5, 0.5, 1, 1, pose)
        forward = pose[:3, 2]
        along = max(float(-camera.position @ forward), 1e-3)
        return Keyframe(time, camera, camera.position + along * forward, level=False)
    target = _vector(key.get("target", (0.0, 0.0, 0.0)))
    if "position" in key:
        return Keyframe(time, Camera.look_at(_vector(key["position"]), target, size=1, fov=fov), target)
    if "yaw" not in key and "pitch" not in key:
        raise KeyError("no camera")
    yaw, pitch = np.deg2rad(float(key.get("yaw", 0.0))), np.deg2rad(float(key.get("pitch", 0.0)))
    distance = float(key.get("distance", NEUTRAL_DISTANCE))
    if not (np.isfinite([yaw, pitch]).all() and np.isfinite(distance) and distance > 0.0):
        raise ValueError("yaw and pitch must be finite and distance above 0")
    camera = Camera.orbit(yaw, pitch, distance=distance, size=1, fov=fov, target=(target[0], target[1], target[2]))
    return Keyframe(time, camera, target)
