"""A textured file rendered back and compared with the field's own pictures."""

from __future__ import annotations

import io
import os
from typing import Any

import cv2
import numpy as np
import trimesh

from gazenerf.errors import UserError
from gazenerf.export.appearance.colours import PartPicture, part_pictures
from gazenerf.geometry import Camera
from gazenerf.heads.interface import BoundField, Part
from gazenerf.image_metrics import psnr

UNSEEN_VIEWS = ((15.0, 8.0), (-45.0, -8.0), (45.0, 15.0))
"""Yaw and pitch, degrees, of views that no texture is baked from."""


def texture_psnr(bound: BoundField, part: Part, data: bytes) -> dict[str, Any]:
    """PSNR of a part's .glb, rendered unlit from `UNSEEN_VIEWS`, against the field's own pictures.

    Args:
        data: The file, metres.

    Returns:
        For a sidecar: `views_yaw_pitch_degrees`, `psnr_db` of each over the pixels that both cover,
        or `not_measured` with the reason.
    """
    pictures = part_pictures(bound, part, UNSEEN_VIEWS)
    try:
        drawn = render_glb(data, [picture.camera for picture in pictures], 1.0 / bound.metres_per_unit)
    except UserError as error:
        return {"not_measured": str(error)}
    values = [_psnr(image, mask, picture) for (image, mask), picture in zip(drawn, pictures, strict=True)]
    return {"views_yaw_pitch_degrees": [list(view) for view in UNSEEN_VIEWS], "psnr_db": values}


def _psnr(image: np.ndarray, mask: np.ndarray, picture: PartPicture) -> float | None:
    value = psnr(image, picture.image, mask & (picture.opacity > 0.5))
    return None if np.isnan(value) else min(value, 100.0)


def render_glb(
    data: bytes, cameras: list[Camera], scale: float, factor: int = 2
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Unlit pictures of a .glb file.

    Args:
        data: The file.
        cameras: All of one size, world units.
        scale: World units in a unit of the file.
        factor: Pictures are rendered so many times larger and averaged down.

    Returns:
        For each camera the picture (H, W, 3) float32 sRGB on black and where the mesh covers whole
        pixels, (H, W) bool.

    Raises:
        UserError: no off-screen OpenGL context can be made.
    """
    os.environ.setdefault("PYOPENGL_PLATFORM", "egl")
    width, height = cameras[0].width, cameras[0].height
    try:
        import pyrender

        renderer = pyrender.OffscreenRenderer(factor * width, factor * height)
    except Exception as error:
        raise UserError(
            f"pyrender cannot open an off-screen context ({error}); install libegl1 (Debian: apt-get install libegl1)"
        ) from error
    mesh = trimesh.load(io.BytesIO(data), file_type="glb", force="mesh", process=False)
    assert isinstance(mesh, trimesh.Trimesh)
    mesh.apply_scale(scale)
    flags = pyrender.RenderFlags.FLAT | pyrender.RenderFlags.SKIP_CULL_FACES
    drawn = []
    try:
        for camera in cameras:
            big = camera.resized(factor * width, factor * height)
            scene = pyrender.Scene(bg_color=(0.0, 0.0, 0.0, 1.0), ambient_light=(1.0, 1.0, 1.0))
            scene.add(pyrender.Mesh.from_trimesh(mesh, smooth=True))
            lens = pyrender.IntrinsicsCamera(big.fx, big.fy, big.cx, big.cy, znear=1.0, zfar=60.0)
            scene.add(lens, pose=big.world_from_opengl_camera)
            rendered: Any = renderer.render(scene, flags=flags)
            colour, depth = rendered
            image = cv2.resize(colour.astype(np.float32) / 255.0, (width, height), interpolation=cv2.INTER_AREA)
            cover = cv2.resize((depth > 0).astype(np.float32), (width, height), interpolation=cv2.INTER_AREA)
            drawn.append((image, cover > 0.999))
    finally:
        renderer.delete()
    return drawn
