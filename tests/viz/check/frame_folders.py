"""Folders of frames as others write them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from PIL import Image

from gazenerf.export.formats.dataset_cameras import transforms
from gazenerf.geometry import Camera

CAMERAS = [Camera.orbit(np.deg2rad(yaw), 0.1, size=(40, 32)) for yaw in (-10, 0, 10)]


def write_folder(folder: Path, cameras: list[Camera] = CAMERAS) -> dict:
    """Pictures of one grey each and a transforms.json; the JSON's content."""
    (folder / "images").mkdir(parents=True, exist_ok=True)
    names = [f"{i}.png" for i in range(len(cameras))]
    for i, name in enumerate(names):
        grey = np.full((cameras[i].height, cameras[i].width, 3), (40 * i + 40) % 256, np.uint8)
        Image.fromarray(grey).save(folder / "images" / name)
    data = transforms(cameras, names)
    save(folder, data)
    return data


def save(folder: Path, data: object) -> None:
    (folder / "transforms.json").write_text(json.dumps(data))


def first(data: dict, **changes) -> dict:
    """The data with its first frame changed."""
    return data | {"frames": [data["frames"][0] | changes, *data["frames"][1:]]}


def textured(camera: Camera) -> np.ndarray:
    """(H, W, 3) of a pattern on the plane z = 0: pictures of one scene, whatever the camera."""
    rays_o, rays_d = camera.rays()
    points = rays_o - rays_o[..., 2:] / rays_d[..., 2:] * rays_d
    waves = 127 + 50 * np.sin(4.0 * points[..., 0]) + 50 * np.cos(5.0 * points[..., 1])
    return np.repeat(waves.astype(np.uint8)[..., None], 3, axis=-1)


def agrees(folder, index: int, away: float = 3.0) -> bool:
    """Whether a frame that was read shows the scene as its camera sees it."""
    frame = folder.frames[index]
    return float(np.abs(frame.image.astype(float) - textured(frame.camera)).mean()) < away


def scene(folder: Path, cameras: list[Camera] = CAMERAS) -> dict:
    """Pictures of the plane; the JSON's content."""
    data = write_folder(folder, cameras)
    for i, camera in enumerate(cameras):
        Image.fromarray(textured(camera)).save(folder / "images" / f"{i}.png")
    return data
