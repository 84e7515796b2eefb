"""Captures by pyrender: pictures, part ids and depth of a head mesh, off screen through EGL."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from gazenerf.errors import UserError
from gazenerf.geometry import Camera
from gazenerf.head_model.interface import PICTURE_LABELS, HeadMesh
from gazenerf.head_model.shading import shade

NEAR, FAR = 1.0, 60.0
_PART_COLOURS = np.array([[90, 90, 90], [160, 160, 160], [230, 230, 230]], dtype=np.uint8)


@dataclass(frozen=True)
class Raster:
    """One rasterised view; see `Capture` for the meaning of the arrays.

    Attributes:
        image: (H, W, 3) uint8 sRGB on black.
        parts: (H, W) uint8, 0 background, 1 face, 2 left eye, 3 right eye.
        depth: (H, W) float32 Euclidean, 0 where nothing is hit.
    """

    image: np.ndarray
    parts: np.ndarray
    depth: np.ndarray


class Rasterizer:
    """Renders heads at one picture size, reusing one off-screen context.

    Args:
        size: (width, height) of the pictures.
        supersampling: Pictures are rendered this many times larger and averaged down.

    Raises:
        UserError: no off-screen OpenGL context can be made.
    """

    def __init__(self, size: tuple[int, int], supersampling: int = 2) -> None:
        os.environ.setdefault("PYOPENGL_PLATFORM", "egl")
        try:
            import pyrender

            self._pyrender = pyrender
            self.size, self.factor = size, supersampling
            self._renderer = pyrender.OffscreenRenderer(size[0] * supersampling, size[1] * supersampling)
        except Exception as error:
            raise UserError(
                f"pyrender cannot open an off-screen context ({error}); "
                "install libegl1 (Debian: apt-get install libegl1)"
            ) from error

    def close(self) -> None:
        """Free the context."""
        self._renderer.delete()

    def __enter__(self) -> Rasterizer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def render(self, mesh: HeadMesh, colours: np.ndarray, camera: Camera) -> Raster:
        """Rasterise a head.

        Args:
            mesh: The head.
            colours: (V, 3) float sRGB in [0, 1].
            camera: Of this rasteriser's size.
        """
        if (camera.width, camera.height) != self.size:
            raise ValueError(f"the camera is {camera.width}x{camera.height}, the rasteriser {self.size}")
        flags = self._pyrender.RenderFlags.FLAT | self._pyrender.RenderFlags.SKIP_CULL_FACES
        rgba = np.concatenate([colours, np.ones((len(colours), 1))], axis=1)
        big = camera.resized(camera.width * self.factor, camera.height * self.factor)
        scene = self._scene(mesh, rgba, big)
        picture, _ = self._draw(scene, big, flags)
        image = cv2.resize(picture, self.size, interpolation=cv2.INTER_AREA)
        part = np.zeros(len(mesh.vertices), dtype=np.int64)
        part[mesh.faces.ravel()] = np.repeat(PICTURE_LABELS[mesh.face_part] - 1, 3)
        ids = np.concatenate([_PART_COLOURS[part], np.full((len(part), 1), 255, np.uint8)], axis=1)
        scene = self._scene(mesh, ids / 255.0, camera)
        with self._one_sample():
            id_picture, depth_z = self._draw(scene, camera, flags)
        seen = depth_z > 0
        nearest = np.abs(id_picture[..., :1].astype(int) - _PART_COLOURS[None, None, :, 0]).argmin(axis=-1) + 1
        parts = np.where(seen, nearest, 0).astype(np.uint8)
        depth = np.where(seen, depth_z / camera.ray_z(), 0.0).astype(np.float32)
        return Raster(np.ascontiguousarray(image), parts, depth)

    def render_lit(self, mesh: HeadMesh, illumination: np.ndarray, camera: Camera, seed: int = 0) -> Raster:
        """Rasterise a head shaded at its vertices.

        Args:
            mesh: The head.
            illumination: (27,) spherical-harmonic coefficients of radiance.
            camera: Of this rasteriser's size.
            seed: Ignored; there is no noise.
        """
        return self.render(mesh, shade(mesh, illumination, camera.position), camera)

    def normals(self, mesh: HeadMesh, camera: Camera) -> np.ndarray:
        """(H, W, 3) float32 interpolated unit world normals at pixel centres, NaN where nothing is hit."""
        flags = self._pyrender.RenderFlags.FLAT | self._pyrender.RenderFlags.SKIP_CULL_FACES
        rgba = np.concatenate([0.5 * mesh.normals + 0.5, np.ones((len(mesh.normals), 1))], axis=1)
        with self._one_sample():
            picture, depth = self._draw(self._scene(mesh, rgba, camera), camera, flags)
        vectors = picture[..., :3].astype(np.float32) / 127.5 - 1.0
        vectors /= np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-6)
        vectors[depth <= 0] = np.nan
        return vectors

    @contextmanager
    def _one_sample(self) -> Iterator[None]:
        """Rasterise at pixel centres: pyrender's multisampled buffer would return a corner's depth."""
        from pyrender import renderer as module

        multisampled = module.glRenderbufferStorageMultisample

        def single(target: int, samples: int, *rest: int) -> None:
            multisampled(target, 0, *rest)

        module.glRenderbufferStorageMultisample = single
        inner: Any = self._renderer._renderer
        inner._delete_main_framebuffer()
        try:
            yield
        finally:
            module.glRenderbufferStorageMultisample = multisampled
            inner._delete_main_framebuffer()

    def _draw(self, scene, camera: Camera, flags: int) -> tuple[np.ndarray, np.ndarray]:
        self._renderer.viewport_width, self._renderer.viewport_height = camera.width, camera.height
        drawn: Any = self._renderer.render(scene, flags=flags)
        colour, depth = drawn
        return np.asarray(colour), np.asarray(depth)

    def _scene(self, mesh: HeadMesh, rgba: np.ndarray, camera: Camera):
        primitive = self._pyrender.Primitive(
            positions=mesh.vertices.astype(np.float32),
            normals=mesh.normals.astype(np.float32),
            color_0=rgba.astype(np.float32),
            indices=mesh.faces.astype(np.uint32),
            mode=4,
            material=self._pyrender.MetallicRoughnessMaterial(
                baseColorFactor=(1.0, 1.0, 1.0, 1.0), metallicFactor=0.0, roughnessFactor=1.0, doubleSided=True
            ),
        )
        scene = self._pyrender.Scene(bg_color=(0.0, 0.0, 0.0, 1.0), ambient_light=(1.0, 1.0, 1.0))
        scene.add(self._pyrender.Mesh([primitive]))
        scene.add(
            self._pyrender.IntrinsicsCamera(camera.fx, camera.fy, camera.cx, camera.cy, znear=NEAR, zfar=FAR),
            pose=camera.world_from_opengl_camera,
        )
        return scene
