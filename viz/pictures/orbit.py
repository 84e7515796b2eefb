"""Fly around a head while its eyes turn."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gazenerf.errors import UserError
from gazenerf.files import whole_file
from gazenerf.geometry import Camera, Gaze
from gazenerf.heads.backgrounds import Background
from gazenerf.heads.interface import BoundField, HeadField
from gazenerf.viz.pictures.drawing import draw_views
from gazenerf.viz.pictures.layout import PAPER, grid_size, tile
from gazenerf.viz.pictures.panels import DEPTH_RANGE, ReferenceRenderer, check_panels, draw_panels

ORBIT_FORMAT = "gazenerf-orbit-1"


def frame_size(camera: Camera, panels: Sequence[str], columns: int | None = None) -> tuple[int, int]:
    """(width, height) of the frames that `render_orbit` makes."""
    return grid_size(len(panels), camera.width, camera.height, columns)


def render_orbit(
    head: HeadField,
    cameras: Sequence[Camera],
    gazes: Sequence[Gaze],
    panels: Sequence[str] = ("image",),
    *,
    reference: ReferenceRenderer | None = None,
    columns: int | None = None,
    labels: bool | None = None,
    geometry_size: int | None = None,
    depth_range: tuple[float, float] = DEPTH_RANGE,
    background: Background | None = None,
) -> Iterator[np.ndarray]:
    """Frames of an orbit, rendered as they are taken: on a CPU one on each core, a few ahead of the one taken.

    The field is bound again only when the gaze changes, and a frame whose camera and gaze are those
    of the frame before is not drawn twice.

    Example:
        >>> cameras = horizontal(60, size=256)
        >>> gazes = look_at_camera(cameras)
        >>> head = Head(field, subject)
        >>> write_video("orbit.mp4", render_orbit(head, cameras, gazes, ("image", "depth")))

    Args:
        head: Who is drawn.
        cameras: One per frame, all of one size.
        gazes: One per frame, head frame.
        panels: Names from `gazenerf.viz.pictures.panels.PANELS`.
        reference: Draws the `reference` panel.
        columns: Panels in a row; chosen when None.
        labels: Draw the panels' names; by default when there is more than one.
        geometry_size: See `draw_panels`.
        depth_range: See `draw_panels`.
        background: See `draw_panels`; also between panels.

    Returns:
        An iterator of (H, W, 3) uint8, H and W from `frame_size`; (H, W, 4) where there is nothing behind.

    Raises:
        UserError: no frames, or panels that cannot be drawn.
        ValueError: not one gaze for each camera, or cameras of different sizes.
    """
    names = check_panels(panels, reference)
    if not cameras:
        raise UserError("no frames to render; give --frames 1 or more")
    if len(cameras) != len(gazes):
        raise ValueError(f"one gaze per camera: got {len(cameras)} cameras and {len(gazes)} gazes")
    if len({(camera.width, camera.height) for camera in cameras}) != 1:
        raise ValueError("the cameras of one orbit must have one size")

    def draw(bound: BoundField, camera: Camera) -> np.ndarray:
        drawn = draw_panels(
            bound, camera, names, reference=reference, geometry_size=geometry_size, depth_range=depth_range,
            background=background,
        )  # fmt: skip
        return tile(drawn, columns, labels, PAPER if background is None else background.paper)

    views = list(zip(cameras, gazes, strict=True))
    workers = None if reference is None else 1  # reference renderers keep to one thread
    return _repeated(draw_views(head, _without_repeats(views), draw, workers), views)


def _without_repeats(views: Sequence[tuple[Camera, Gaze]]) -> list[tuple[Camera, Gaze]]:
    return [view for before, view in zip([None, *views], views, strict=False) if not _same(before, view)]


def _repeated(frames: Iterator[np.ndarray], views: Sequence[tuple[Camera, Gaze]]) -> Iterator[np.ndarray]:
    """A frame for every view from those of `_without_repeats`."""
    frame = np.empty(0)
    for before, view in zip([None, *views], views, strict=False):
        frame = frame if _same(before, view) else next(frames)
        yield frame


def orbit_sidecar(
    bound: BoundField,
    cameras: Sequence[Camera],
    gazes: Sequence[Gaze],
    *,
    panels: Sequence[str],
    fps: float,
    about: dict[str, Any] | None = None,
) -> dict[str, Any]:
    """What a player cannot see in the video, JSON-able: subject, weights, frame, cameras and gazes.

    Args:
        bound: The field at any gaze of the orbit; names the subject and weights.
        cameras: One per frame.
        gazes: One per frame.
        panels: What every frame shows.
        fps: Frames per second.
        about: More to keep, such as the names of the paths.
    """
    return {
        "format": ORBIT_FORMAT,
        "subject": bound.subject.name,
        "weights": bound.weights_hash,
        "metres_per_unit": bound.metres_per_unit,
        "world": "right-handed, Y up, face toward +Z, +X toward the subject's left",
        "camera_axes": "OpenCV: x right, y down, z forward; pixel centres at +0.5; size is of one panel",
        "panels": list(panels),
        "fps": fps,
        **(about or {}),
        "frames": [
            {"gaze_degrees": {"pitch": gaze.degrees[0], "yaw": gaze.degrees[1]}, "camera": camera.to_dict()}
            for camera, gaze in zip(cameras, gazes, strict=True)
        ],
    }


def sidecar_path(path: str | Path) -> Path:
    """Where the sidecar of a video lies: its name and `.json`; `orbit.json` in a folder of pictures."""
    path = Path(path)
    if path.suffix == "":
        return path / "orbit.json"
    return path.parent / "orbit.json" if path.suffix.lower() == ".png" else path.with_name(path.name + ".json")


def write_sidecar(path: str | Path, sidecar: dict[str, Any]) -> Path:
    """Write a sidecar for the video at `path`; returns the sidecar's path.

    Raises:
        UserError: it cannot be written.
    """
    target = sidecar_path(path)
    with whole_file(target) as temporary:
        temporary.write_text(json.dumps(sidecar, indent=1), encoding="utf-8")
    return target


def _same(a: tuple[Camera, Gaze] | None, b: tuple[Camera, Gaze]) -> bool:
    return a is not None and a[1] == b[1] and (a[0] is b[0] or a[0].to_dict() == b[0].to_dict())
