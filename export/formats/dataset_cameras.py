"""Cameras of a dataset, and the points that its pictures show, in the texts that nerfstudio and COLMAP read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from gazenerf.geometry import Camera

DEPTH_UNIT = 0.001
"""What one step of depth is in the unit of the poses; nerfstudio takes this unless it is told otherwise."""


@dataclass(frozen=True)
class SeenPoints:
    """Points on the surface that one picture shows.

    Attributes:
        pixels: (N, 2) image coordinates in the picture.
        points: (N, 3) world units.
        colours: (N, 3) uint8 sRGB.
    """

    pixels: np.ndarray
    points: np.ndarray
    colours: np.ndarray


def depth_name(picture: str) -> str:
    """The depth file of a picture."""
    return str(Path(picture).with_suffix(".npy"))


def mask_name(picture: str) -> str:
    """The mask of a picture: its name and another ending, as COLMAP looks for it."""
    return f"{picture}.png"


def transforms(
    cameras: Sequence[Camera], names: Sequence[str], depth: bool = False, masks: bool = False
) -> dict[str, Any]:
    """The content of a transforms.json: intrinsics of each frame, poses with OpenGL camera axes, depth in mm, masks."""
    frames: list[dict[str, Any]] = [
        {
            "file_path": f"images/{name}",
            "fl_x": camera.fx,
            "fl_y": camera.fy,
            "cx": camera.cx,
            "cy": camera.cy,
            "w": camera.width,
            "h": camera.height,
            "transform_matrix": camera.world_from_opengl_camera.tolist(),
        }
        for camera, name in zip(cameras, names, strict=True)
    ]
    content = {"camera_model": "OPENCV", "ply_file_path": "points.ply", "frames": frames}
    for frame, name in zip(frames, names, strict=True):
        frame |= {"depth_file_path": f"depth/{depth_name(name)}"} if depth else {}
        frame |= {"mask_path": f"masks/{mask_name(name)}"} if masks else {}
    return {"depth_unit_scale_factor": DEPTH_UNIT, **content} if depth else content


def colmap_model(cameras: Sequence[Camera], names: Sequence[str], seen: Sequence[SeenPoints]) -> dict[str, str]:
    """The texts of a COLMAP model: cameras.txt, images.txt, points3D.txt; each point in one picture's track."""
    lenses: dict[tuple[float, ...], int] = {}
    images, points, first = [], [], 1
    for i, (camera, name, shown) in enumerate(zip(cameras, names, seen, strict=True), 1):
        lens = (camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy)
        number = lenses.setdefault(lens, len(lenses) + 1)
        pose = camera.camera_from_world
        x, y, z, w = Rotation.from_matrix(pose[:3, :3]).as_quat()
        images.append(f"{i} {_numbers((w, x, y, z, *pose[:3, 3]))} {number} {name}")
        ids = range(first, first + len(shown.points))
        images.append(" ".join(f"{u:.3f} {v:.3f} {n}" for (u, v), n in zip(shown.pixels, ids, strict=True)))
        points += [
            f"{n} {p[0]:.9g} {p[1]:.9g} {p[2]:.9g} {c[0]} {c[1]} {c[2]} 0 {i} {k}"
            for k, (n, p, c) in enumerate(zip(ids, shown.points, shown.colours, strict=True))
        ]
        first += len(shown.points)
    listed = [f"{number} PINHOLE {lens[0]} {lens[1]} {_numbers(lens[2:])}" for lens, number in lenses.items()]
    return {
        "cameras.txt": _text("CAMERA_ID MODEL WIDTH HEIGHT FX FY CX CY", listed),
        "images.txt": _text("IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME, then X Y POINT3D_ID of its points", images),
        "points3D.txt": _text("POINT3D_ID X Y Z R G B ERROR IMAGE_ID POINT2D_IDX", points),
    }


def _numbers(values: Sequence[float]) -> str:
    return " ".join(repr(float(value)) for value in values)


def _text(columns: str, lines: Sequence[str]) -> str:
    return "\n".join([f"# {columns}; metres", *lines]) + "\n"
