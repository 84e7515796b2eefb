"""Where a camera flies and where the eyes look, frame by frame.

A camera path is a list of `Camera`, a gaze path a list of `Gaze`. Every path but `still`, `hold` and
open keyframes is a loop: the frame after the last is the first, which is not repeated, so a player
that starts over shows no pause and no jump. Gazes are in the head frame, which is the world frame.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from gazenerf.errors import UserError
from gazenerf.geometry.cameras import NEUTRAL_DISTANCE, NEUTRAL_FOV, Camera
from gazenerf.geometry.gaze import Gaze

PUBLISHED_RADIUS = 5.3
"""Radius of the published code's camera circle, world units."""

PUBLISHED_FRAMES = 45
"""Frames of the published code's camera circle."""

EYE_MIDPOINT = (0.0, 0.0, 0.8)
"""Middle between the eyes of an average head, world units, where a subject's own is not known."""


@dataclass(frozen=True)
class GazeRange:
    """The gazes a field was trained on, symmetric about zero.

    Attributes:
        pitch: Largest pitch, radians.
        yaw: Largest yaw, radians.
    """

    pitch: float = float(np.deg2rad(25.0))
    yaw: float = float(np.deg2rad(35.0))

    def clip(self, gaze: Gaze) -> Gaze:
        """The nearest gaze inside, each angle on its own."""
        return Gaze(
            float(np.clip(gaze.pitch, -self.pitch, self.pitch)),
            float(np.clip(gaze.yaw, -self.yaw, self.yaw)),
        )

    def contains(self, gaze: Gaze) -> bool:
        """Whether the gaze lies inside, borders included (to 1e-6 radians)."""
        return abs(gaze.pitch) <= self.pitch + 1e-6 and abs(gaze.yaw) <= self.yaw + 1e-6

    def beyond(self, gazes: Iterable[Gaze]) -> BeyondTraining | None:
        """Which of some gazes lies farthest outside; None where none does."""
        outside = [gaze for gaze in gazes if not self.contains(gaze)]
        if not outside:
            return None
        return BeyondTraining(max(outside, key=lambda gaze: abs(gaze.pitch) + abs(gaze.yaw)), self)

    def __str__(self) -> str:
        return f"pitch +-{np.rad2deg(self.pitch):.0f} and yaw +-{np.rad2deg(self.yaw):.0f} degrees"


@dataclass(frozen=True)
class BeyondTraining:
    """A gaze that a field was never trained on.

    Attributes:
        gaze: The one farthest outside.
        limits: What the field was trained on.
    """

    gaze: Gaze
    limits: GazeRange

    def __str__(self) -> str:
        pitch, yaw = self.gaze.degrees
        return f"gaze {pitch:g} {yaw:g} is beyond what this field was trained on ({self.limits}); expect artefacts"


MOST_FRAMES = 100_000
"""Frames of a path: 55 minutes of video. More is a mistyped number."""


def check_frames(frames: int) -> None:
    """Raise UserError where a path cannot have so many frames."""
    if not 1 <= frames <= MOST_FRAMES:
        raise UserError(f"a path has 1 to {MOST_FRAMES} frames, got {frames}; give another --frames")


def phases(frames: int) -> np.ndarray:
    """(frames,) angles 2 pi i / frames of a loop, the end left out.

    Raises:
        UserError: fewer than one frame.
    """
    check_frames(frames)
    return 2.0 * np.pi * np.arange(frames) / frames


# Camera paths


def still(frames: int, camera: Camera) -> list[Camera]:
    """The same camera in every frame."""
    return [camera] * len(phases(frames))


def circle(
    frames: int = PUBLISHED_FRAMES,
    *,
    radius: float = PUBLISHED_RADIUS,
    z: float = NEUTRAL_DISTANCE,
    size: int | tuple[int, int] = 256,
    fov: float = NEUTRAL_FOV,
) -> list[Camera]:
    """The published novel-view path: a circle in a plane of constant z, looking at the origin.

    Args:
        frames: Frames of one round.
        radius: Radius of the circle, world units.
        z: Height of its plane in front of the origin, world units.
        size: Image size, one number or (width, height).
        fov: Horizontal field of view, radians.
    """
    return [
        Camera.look_at(np.array([radius * np.cos(t), radius * np.sin(t), z]), size=size, fov=fov)
        for t in phases(frames)
    ]


def horizontal(
    frames: int,
    *,
    sweep: float = float(np.deg2rad(60.0)),
    pitch: float = 0.0,
    distance: float = NEUTRAL_DISTANCE,
    size: int | tuple[int, int] = 256,
    fov: float = NEUTRAL_FOV,
) -> list[Camera]:
    """From the front to the subject's left, over to the right and back, easing at both ends.

    Args:
        frames: Frames there and back.
        sweep: Largest yaw either way, radians.
        pitch: Constant height, radians, positive up.
        distance: World units from the origin.
        size: Image size, one number or (width, height).
        fov: Horizontal field of view, radians.
    """
    return [Camera.orbit(sweep * np.sin(t), pitch, distance=distance, size=size, fov=fov) for t in phases(frames)]


def full_turn(
    frames: int,
    *,
    pitch: float = 0.0,
    distance: float = NEUTRAL_DISTANCE,
    size: int | tuple[int, int] = 256,
    fov: float = NEUTRAL_FOV,
) -> list[Camera]:
    """Once around the head at constant speed, by the subject's left first; arguments as `horizontal`."""
    return [Camera.orbit(t, pitch, distance=distance, size=size, fov=fov) for t in phases(frames)]


def figure_eight(
    frames: int,
    *,
    sweep: float = float(np.deg2rad(45.0)),
    pitch: float = float(np.deg2rad(15.0)),
    distance: float = NEUTRAL_DISTANCE,
    size: int | tuple[int, int] = 256,
    fov: float = NEUTRAL_FOV,
) -> list[Camera]:
    """A lying eight about the front: yaw swings once while pitch swings twice.

    Args:
        frames: Frames of one eight.
        sweep: Largest yaw, radians.
        pitch: Largest pitch, radians.
        distance: World units from the origin.
        size: Image size, one number or (width, height).
        fov: Horizontal field of view, radians.
    """
    return [
        Camera.orbit(sweep * np.sin(t), pitch * np.sin(2.0 * t), distance=distance, size=size, fov=fov)
        for t in phases(frames)
    ]


def dolly(
    frames: int,
    *,
    near: float = 0.7 * NEUTRAL_DISTANCE,
    far: float = NEUTRAL_DISTANCE,
    yaw: float = 0.0,
    pitch: float = 0.0,
    size: int | tuple[int, int] = 256,
    fov: float = NEUTRAL_FOV,
) -> list[Camera]:
    """From `far` in to `near` and out again along one direction, easing at both ends.

    Args:
        frames: Frames in and out.
        near: Smallest distance from the origin, world units.
        far: Largest distance.
        yaw: Direction, radians, as in `Camera.orbit`.
        pitch: Direction, radians.
        size: Image size, one number or (width, height).
        fov: Horizontal field of view, radians.

    Raises:
        UserError: not 0 < near < far.
    """
    if not 0.0 < near < far:
        raise UserError(f"a dolly needs 0 < near < far, got near {near:g} and far {far:g}")
    middle, half = 0.5 * (near + far), 0.5 * (far - near)
    return [Camera.orbit(yaw, pitch, distance=middle + half * np.cos(t), size=size, fov=fov) for t in phases(frames)]


CAMERA_PATHS: tuple[str, ...] = ("horizontal", "circle", "full-turn", "figure-eight", "dolly", "still")
"""Names `camera_path` knows; a JSON file of keyframes is the other choice, see `keyframes`."""


def camera_path(
    name: str,
    frames: int,
    *,
    size: int | tuple[int, int] = 256,
    fov: float = NEUTRAL_FOV,
    distance: float = NEUTRAL_DISTANCE,
    sweep: float | None = None,
    yaw: float = 0.0,
    pitch: float | None = None,
) -> list[Camera]:
    """A camera path by name, about the origin.

    Args:
        name: One of `CAMERA_PATHS`.
        frames: Number of cameras.
        size: Image size, one number or (width, height).
        fov: Horizontal field of view, radians.
        distance: World units from the origin; for `circle` the z of its plane, for `dolly` the far end.
        sweep: Largest yaw of `horizontal` and `figure-eight`, radians; None for the path's own.
        yaw: Direction of `still` and `dolly`, radians.
        pitch: Height of the path, radians (for `figure-eight` the largest); None for the path's own.
            `circle` has none.

    Raises:
        UserError: unknown name, no frames, or a camera that cannot be placed.
    """
    swing = {} if sweep is None else {"sweep": sweep}
    height = {} if pitch is None else {"pitch": pitch}
    makers: dict[str, Callable[[], list[Camera]]] = {
        "horizontal": lambda: horizontal(frames, distance=distance, size=size, fov=fov, **swing, **height),
        "circle": lambda: circle(frames, z=distance, size=size, fov=fov),
        "full-turn": lambda: full_turn(frames, distance=distance, size=size, fov=fov, **height),
        "figure-eight": lambda: figure_eight(frames, distance=distance, size=size, fov=fov, **swing, **height),
        "dolly": lambda: dolly(frames, near=0.7 * distance, far=distance, yaw=yaw, size=size, fov=fov, **height),
        "still": lambda: still(frames, Camera.orbit(yaw, pitch or 0.0, distance=distance, size=size, fov=fov)),
    }
    if name not in makers:
        raise UserError(f"unknown camera path {name!r}; choose {', '.join(CAMERA_PATHS)} or a .json file of keyframes")
    try:
        return makers[name]()
    except ValueError as error:
        raise UserError(f"cannot place the camera: {error}; change distance, size, pitch or field of view") from error


# Gaze paths


def hold(frames: int, gaze: Gaze = Gaze()) -> list[Gaze]:  # noqa: B008
    """The same gaze in every frame."""
    return [gaze] * len(phases(frames))


def gaze_sweep(frames: int, limits: GazeRange = GazeRange()) -> list[Gaze]:
    """Half the time yaw swings left, right and back, the other half pitch swings up, down and back."""
    t = 2.0 * phases(frames)
    swing = np.sin(t)
    first = t < 2.0 * np.pi - 1e-9
    return [
        Gaze(0.0, float(limits.yaw * s)) if is_yaw else Gaze(float(limits.pitch * s), 0.0)
        for s, is_yaw in zip(swing, first, strict=True)
    ]


def gaze_circle(frames: int, limits: GazeRange = GazeRange()) -> list[Gaze]:
    """Once around the border of the range, on the ellipse through its largest angles, left first."""
    return [Gaze(float(limits.pitch * np.sin(t)), float(limits.yaw * np.cos(t))) for t in phases(frames)]


def targets(frames: int, gazes: Sequence[Gaze], moving: float = 0.35) -> list[Gaze]:
    """Look at each gaze in turn and return to the first, holding on each and moving smoothly between.

    Args:
        frames: Frames of the whole round; every gaze gets the same share.
        gazes: At least one.
        moving: Part of a share in which the eyes move, in (0, 1]; the rest is held. The move follows
            the minimum-jerk profile 10 s^3 - 15 s^4 + 6 s^5 in both angles.

    Raises:
        UserError: no gazes, or `moving` outside (0, 1].
    """
    if not gazes:
        raise UserError("a gaze path of targets needs at least one gaze, PITCH YAW in degrees")
    if not 0.0 < moving <= 1.0:
        raise UserError(f"the moving part must be above 0 and at most 1, got {moving:g}")
    path = []
    for share in phases(frames) / (2.0 * np.pi) * len(gazes):
        index = int(share)
        s = np.clip((share - index - (1.0 - moving)) / moving, 0.0, 1.0)
        eased = float(s**3 * (10.0 - 15.0 * s + 6.0 * s * s))
        a, b = gazes[index % len(gazes)], gazes[(index + 1) % len(gazes)]
        path.append(Gaze(a.pitch + eased * (b.pitch - a.pitch), a.yaw + eased * (b.yaw - a.yaw)))
    return path


def look_at_camera(
    cameras: Sequence[Camera],
    limits: GazeRange = GazeRange(),
    eyes: np.ndarray | tuple[float, float, float] = EYE_MIDPOINT,
) -> list[Gaze]:
    """Keep looking at the camera as far as the range allows.

    Past 120 degrees of yaw the camera is behind the head; from there the eyes return to the middle,
    so a full turn has no jump at the back.

    Args:
        cameras: The camera of every frame.
        limits: The eyes stop at these angles.
        eyes: (3,) middle between the eyes, world units.
    """
    turn_back, behind = np.deg2rad(120.0), np.pi
    path = []
    for camera in cameras:
        wanted = Gaze.from_vector(camera.position - np.asarray(eyes, dtype=np.float64))
        s = np.clip((abs(wanted.yaw) - turn_back) / (behind - turn_back), 0.0, 1.0)
        fade = float(1.0 - s * s * (3.0 - 2.0 * s))
        held = limits.clip(wanted)
        path.append(Gaze(held.pitch * fade, held.yaw * fade))
    return path


GAZE_PATHS: tuple[str, ...] = ("hold", "sweep", "circle", "targets", "look-at-camera")
"""Names `gaze_path` knows."""


def gaze_path(
    name: str,
    cameras: Sequence[Camera],
    *,
    gazes: Sequence[Gaze] = (),
    limits: GazeRange | None = None,
    eyes: np.ndarray | tuple[float, float, float] = EYE_MIDPOINT,
) -> list[Gaze]:
    """A gaze path by name, one gaze for each camera.

    Args:
        name: One of `GAZE_PATHS`.
        cameras: The camera of every frame.
        gazes: What `hold` holds (the first; straight ahead by default) and `targets` visits (by
            default the middle and four corners at 80 % of the range).
        limits: The field's trained range, which `sweep`, `circle` and `look-at-camera` stay inside;
            `GazeRange()` where it is not known.
        eyes: (3,) middle between the eyes, world units.

    Raises:
        UserError: unknown name, or no cameras.
    """
    frames = len(phases(len(cameras)))
    limits = limits or GazeRange()
    if name == "hold":
        return hold(frames, gazes[0] if gazes else Gaze())
    if name == "sweep":
        return gaze_sweep(frames, limits)
    if name == "circle":
        return gaze_circle(frames, limits)
    if name == "targets":
        corners = [Gaze(p * 0.8 * limits.pitch, y * 0.8 * limits.yaw) for p, y in ((1, 1), (-1, 1), (-1, -1), (1, -1))]
        return targets(frames, gazes or [Gaze(), *corners])
    if name == "look-at-camera":
        return look_at_camera(cameras, limits, eyes)
    raise UserError(f"unknown gaze path {name!r}; choose {', '.join(GAZE_PATHS)}")
