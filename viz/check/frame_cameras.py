"""Cameras as a transforms.json gives them: intrinsics of several kinds, lens distortion, poses."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from gazenerf.errors import UserError
from gazenerf.geometry import Camera

HUGE = 1e9
"""No number of a camera is as large."""

FOCAL = (0.05, 1000.0)
"""Focal lengths of any use, in widths of the picture."""

FISHEYE = "OPENCV_FISHEYE"
MODELS = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", FISHEYE)

DISTORTION = ("k1", "k2", "p1", "p2", "k3")
"""OpenCV's order."""


@dataclass(frozen=True)
class Lens:
    """How a lens bends straight lines.

    Attributes:
        fisheye: By OpenCV's fish-eye model (k1 to k4) instead of its usual one (k1, k2, p1, p2, k3).
        bend: The coefficients, in OpenCV's order.
    """

    fisheye: bool
    bend: np.ndarray

    def __bool__(self) -> bool:
        return self.fisheye or bool(np.any(self.bend))

    def straightened(self, image: np.ndarray, camera: Camera) -> np.ndarray:
        """The picture without distortion, same intrinsics; OpenCV counts pixel centres from 0."""
        k = camera.intrinsics
        k[:2, 2] -= 0.5
        if self.fisheye:
            return cv2.fisheye.undistortImage(image, k, self.bend, Knew=k)
        return cv2.undistort(image, k, self.bend)


def number(entry: dict[str, Any], key: str, name: str, default: float | None = None) -> float:
    value = entry.get(key, default)
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) < HUGE:
        raise UserError(f"{key} of {name} is {repr(value)[:40]}; a finite number is needed")
    return float(value)


def read_camera(entry: dict[str, Any], name: str, size: tuple[int, int]) -> tuple[Camera, Lens, float]:
    """The camera of a picture, its lens, and by how much the picture is smaller than the one the file speaks of.

    Args:
        entry: A frame's keys, with those that all frames share.
        name: Of the frame, for messages.
        size: Width and height of the picture.

    Raises:
        UserError: unusable numbers, an unknown model, or a size that is not the picture's times a factor.
    """
    model = entry.get("camera_model", "OPENCV")
    if model not in MODELS:
        raise UserError(f"{name} was taken by a {str(model)[:40]} camera; read are {', '.join(MODELS)}")
    told, smaller = _told_size(entry, name, size)
    k = _intrinsics(entry, name, told)
    fisheye = model == FISHEYE
    keys = ("k1", "k2", "k3", "k4") if fisheye else DISTORTION
    if unread := [key for key in ("k4", "k5", "k6") if key not in keys and entry.get(key)]:
        raise UserError(f"{name} has distortion {unread[0]}, which is not read; undistort the pictures first")
    bend = np.array([number(entry, key, name, 0.0) for key in keys])
    try:
        camera = Camera.from_opengl(k, _pose(entry, name), *told)
    except ValueError as error:
        raise UserError(f"the camera of {name} is unusable: {error}") from error
    return camera if told == size else camera.resized(*size), Lens(fisheye, bend), smaller


def _told_size(entry: dict[str, Any], name: str, size: tuple[int, int]) -> tuple[tuple[int, int], float]:
    """The size that intrinsics are for, and how many times larger than the picture it is.

    nerfstudio keeps pictures of a half, a quarter and so on beside the large ones, rounded to whole pixels.
    """
    told = tuple(
        round(number(entry, key, name)) if key in entry else side for key, side in zip(("w", "h"), size, strict=True)
    )
    if told == size:
        return size, 1.0
    share = max(told[0] / size[0], told[1] / size[1])
    fits = all(abs(whole / share - side) <= 1.0 for whole, side in zip(told, size, strict=True))
    if not fits or share <= 1.0 or not ("w" in entry and "h" in entry):
        raise UserError(
            f"{name} is {size[0]}x{size[1]} but the file says {told[0]}x{told[1]}; they must agree, or the picture be "
            "smaller by one factor"
        )
    return (told[0], told[1]), share


def _intrinsics(entry: dict[str, Any], name: str, size: tuple[int, int]) -> np.ndarray:
    """K (3, 3) in pixels of the told size."""
    width, height = size
    if "fl_x" in entry:
        fx = number(entry, "fl_x", name)
        fy = number(entry, "fl_y", name, fx)
    elif "camera_angle_x" in entry:
        angle = number(entry, "camera_angle_x", name)
        if not 0.0 < angle < math.pi:
            raise UserError(f"camera_angle_x of {name} is {angle:g}; it must lie between 0 and pi radians")
        fx = fy = 0.5 * width / math.tan(0.5 * angle)
        if "camera_angle_y" in entry and 0.0 < (tall := number(entry, "camera_angle_y", name)) < math.pi:
            fy = 0.5 * height / math.tan(0.5 * tall)
    else:
        raise UserError(f"{name} has neither fl_x nor camera_angle_x, so its focal length is not known")
    if not all(FOCAL[0] * width < focal < FOCAL[1] * width for focal in (fx, fy)):
        raise UserError(f"the focal length of {name} is {fx:g}, {fy:g} px for a width of {width}; is it in pixels?")
    cx, cy = number(entry, "cx", name, width / 2.0), number(entry, "cy", name, height / 2.0)
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def _pose(entry: dict[str, Any], name: str) -> np.ndarray:
    """(4, 4) pose with OpenGL axes, its rotation made exact: files round."""
    try:
        rows = np.array(entry["transform_matrix"], dtype=np.float64)
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise UserError(f"{name} has no transform_matrix of numbers") from error
    if rows.shape not in ((4, 4), (3, 4)):
        raise UserError(f"transform_matrix of {name} has shape {rows.shape}; (4, 4) is needed")
    if not np.isfinite(rows).all() or np.abs(rows).max() > HUGE:
        raise UserError(f"transform_matrix of {name} holds NaN, infinite or huge values")
    pose = np.eye(4)
    pose[:3] = rows[:3]
    u, values, vt = np.linalg.svd(pose[:3, :3])
    if np.abs(values - 1.0).max() > 0.01 or np.linalg.det(pose[:3, :3]) < 0:
        raise UserError(f"transform_matrix of {name} is no rotation and shift: it scales, shears or mirrors")
    pose[:3, :3] = u @ vt
    return pose
