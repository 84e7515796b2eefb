"""Captures by Mitsuba 3: path-traced pictures, part ids and depth of a head mesh; no OpenGL."""

from __future__ import annotations

import numpy as np

from gazenerf.data.mitsuba_scene import MitsubaScene, load_mitsuba, whole_grid
from gazenerf.data.rasterizer import Raster
from gazenerf.errors import UserError
from gazenerf.geometry import Camera
from gazenerf.head_model.interface import HeadMesh

SAMPLES = 64
"""Light paths per pixel by default; leaves about 2 of 255 levels of noise on skin."""

MAX_SAMPLES = 4096


class PathTracer:
    """Path traces heads at one picture size.

    Args:
        size: (width, height) of the pictures.
        samples: Light paths per pixel, 1 to `MAX_SAMPLES`; rounded up to a whole grid.

    Raises:
        UserError: mitsuba cannot be loaded, or `samples` is out of range.
    """

    def __init__(self, size: tuple[int, int], samples: int = SAMPLES) -> None:
        if not 1 <= samples <= MAX_SAMPLES:
            raise UserError(f"--samples goes from 1 to {MAX_SAMPLES}, got {samples}")
        load_mitsuba()
        self.size, self.samples = size, whole_grid(samples)

    def __enter__(self) -> PathTracer:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def render_lit(self, mesh: HeadMesh, illumination: np.ndarray, camera: Camera, seed: int = 0) -> Raster:
        """Path trace a head; its parts and depth are those of the rays through the pixels' centres.

        Args:
            mesh: The head.
            illumination: (27,) spherical-harmonic coefficients of radiance.
            camera: Of this path tracer's size.
            seed: Of the noise, 0 to 2^32 - 1.

        Raises:
            ValueError: the camera is of another size, or its fx and fy differ.
        """
        if (camera.width, camera.height) != self.size:
            raise ValueError(f"the camera is {camera.width}x{camera.height}, the path tracer {self.size}")
        scene = MitsubaScene(mesh, illumination)
        depth, _, parts = scene.geometry(camera)
        picture = scene.picture(camera, self.samples, seed)
        return Raster((255.0 * picture).round().astype(np.uint8), parts, np.nan_to_num(depth, nan=0.0))
