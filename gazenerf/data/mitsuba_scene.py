"""A head in a Mitsuba 3 scene: exact geometry at pixel centres, and path-traced pictures.

The light is the subject's spherical-harmonic code as an environment map. Such a light is too smooth
to be seen as a highlight, so a share of its strongest direction is gathered into a small disc and
its first nine harmonics are taken out of the rest: bands 0 to 2, and with them nearly all of the
diffuse light, stay those of the code, and the cornea has something to reflect.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from gazenerf.errors import UserError
from gazenerf.geometry import Camera
from gazenerf.head_model.interface import EYE_LEFT, EYE_RIGHT, PICTURE_LABELS, HeadMesh
from gazenerf.head_model.shading import dominant_direction, linear_to_srgb, spherical_harmonics

VARIANT = "scalar_rgb"
"""Runs everywhere; the just-in-time variants need an LLVM that fits, and abort the process without."""

CORNEA_INDEX = 1.376
"""Refractive index of the cornea."""

EYE_ROUGHNESS = 0.1
"""Of the tear film over the whole eyeball; its microfacet width is the square."""

CATCHLIGHT_SHARE = 0.7
"""Share of the strongest light that comes from the disc."""

CATCHLIGHT_RADIUS = float(np.deg2rad(8.0))
"""Angular radius of the disc."""

BOUNCES = 3
"""Longest light path in segments: direct light and one reflection between surfaces."""

LIGHT_ROWS = 128
BLOCK = 32
"""Pixels to a side of the tiles of a picture; fixed, because noise depends on it."""


def whole_grid(samples: int) -> int:
    """The least number of paths, not below `samples`, that fills the sampler's grid in each pixel."""
    columns = math.isqrt(samples)
    return columns * -(-samples // columns)


def load_mitsuba() -> Any:
    """The `mitsuba` module with the variant set.

    Raises:
        UserError: it is not installed, or a library that it needs is missing.
    """
    try:
        import mitsuba as mi

        mi.set_variant(VARIANT)
    except (ImportError, OSError) as error:
        raise UserError(f"mitsuba cannot be loaded ({error}); install it with: pip install mitsuba") from error
    return mi


def light_picture(illumination: np.ndarray, rows: int = LIGHT_ROWS, catchlight: bool = True) -> np.ndarray:
    """The environment map of an illumination code.

    Args:
        illumination: (27,) spherical-harmonic coefficients of radiance.
        rows: Height; the width is twice that.
        catchlight: Gather a share of the strongest direction into a disc that the eyes reflect.

    Returns:
        (rows, 2 rows, 3) float32 radiance, at least 0, in Mitsuba's latitude-longitude layout with Y up.
    """
    v, u = np.meshgrid((np.arange(rows) + 0.5) / rows, (np.arange(2 * rows) + 0.5) / (2 * rows), indexing="ij")
    theta, phi = np.pi * v, 2.0 * np.pi * u
    directions = np.stack([np.sin(theta) * np.sin(phi), np.cos(theta), -np.sin(theta) * np.cos(phi)], axis=-1)
    solid_angle = np.sin(theta) * (np.pi / rows) ** 2
    code = np.asarray(illumination, dtype=np.float64).reshape(9, 3)
    basis = spherical_harmonics(directions)
    if not catchlight:
        return np.maximum(basis @ code, 0.0).astype(np.float32)
    toward = dominant_direction(illumination)
    band = spherical_harmonics(toward)[1:4]
    strength = CATCHLIGHT_SHARE * np.maximum(band @ code[1:4] / (band @ band), 0.0)
    softness = 0.3 * CATCHLIGHT_RADIUS
    angle = np.arccos(np.clip(directions @ toward, -1.0, 1.0))
    disc = np.clip((CATCHLIGHT_RADIUS - angle) / softness + 0.5, 0.0, 1.0)
    disc /= (disc * solid_angle).sum()
    projected = np.einsum("hw,hwk->k", disc * solid_angle, basis)
    rest = basis @ (code - projected[:, None] * strength)
    return np.maximum(rest + disc[..., None] * strength, 0.0).astype(np.float32)


def perspective_sensor(mi: Any, camera: Camera, pixel_format: str, sampler: dict[str, Any]) -> dict[str, Any]:
    """Mitsuba's description of a camera with square pixels, each the mean over its area.

    Args:
        mi: The `mitsuba` module with its variant set.
        camera: World units.
        pixel_format: `rgb` or `rgba`.
        sampler: Its description.
    """
    return {
        "type": "perspective",
        "to_world": mi.ScalarTransform4f(camera.world_from_mitsuba_camera),
        "fov": float(np.rad2deg(2.0 * np.arctan(0.5 * camera.width / camera.fx))),
        "fov_axis": "x",
        "principal_point_offset_x": 0.5 - camera.cx / camera.width,
        "principal_point_offset_y": 0.5 - camera.cy / camera.height,
        "film": {
            "type": "hdrfilm",
            "width": camera.width,
            "height": camera.height,
            "pixel_format": pixel_format,
            "rfilter": {"type": "box"},
        },
        "sampler": sampler,
    }


class MitsubaScene:
    """A head in a Mitsuba scene.

    Args:
        mesh: The head.
        illumination: (27,) radiance in spherical harmonics, the light of pictures; None when none are wanted.
        catchlight: See `light_picture`; without it pictures of few light paths have less noise.

    Raises:
        UserError: mitsuba cannot be loaded.
    """

    def __init__(self, mesh: HeadMesh, illumination: np.ndarray | None = None, catchlight: bool = True) -> None:
        self._mi = load_mitsuba()
        parts = [int(part) for part in np.unique(mesh.face_part)]
        scene = {"type": "scene"} | {f"part{part}": self._shape(mesh, part) for part in parts}
        if illumination is not None:
            light = light_picture(illumination, catchlight=catchlight)
            scene["light"] = {"type": "envmap", "bitmap": self._mi.Bitmap(light)}
        self._scene = self._mi.load_dict(scene)

    def _shape(self, mesh: HeadMesh, part: int) -> Any:
        """One part; its texture coordinates say which, so that `geometry` can tell the part that a ray meets."""
        mi = self._mi
        used, faces = np.unique(mesh.part_faces(part), return_inverse=True)
        colour = {"type": "mesh_attribute", "name": "vertex_color"}
        skin = {"type": "twosided", "skin": {"type": "diffuse", "reflectance": colour}}
        eye = {"type": "principled", "base_color": colour, "roughness": EYE_ROUGHNESS, "eta": CORNEA_INDEX}
        properties = mi.Properties()
        properties["bsdf"] = mi.load_dict(eye if part in (EYE_LEFT, EYE_RIGHT) else skin)
        shape = mi.Mesh(
            f"part{part}", len(used), faces.size // 3, properties, has_vertex_normals=True, has_vertex_texcoords=True
        )
        shape.add_attribute("vertex_color", 3, np.clip(mesh.albedo[used], 0.0, 1.0).astype(np.float32).ravel())
        values = mi.traverse(shape)
        values["vertex_positions"] = mesh.vertices[used].astype(np.float32).ravel()
        values["vertex_normals"] = mesh.normals[used].astype(np.float32).ravel()
        values["vertex_texcoords"] = np.full(2 * len(used), PICTURE_LABELS[part], np.float32)
        values["faces"] = faces.astype(np.uint32).ravel()
        values.update()
        return shape

    def geometry(self, camera: Camera) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What the ray through each pixel's centre meets first.

        Returns:
            Euclidean distance (H, W) float32, world units, and interpolated unit world normals
            (H, W, 3) float32, both NaN off the mesh; parts (H, W) uint8 as in `Raster`.

        Raises:
            ValueError: the camera's fx and fy differ.
        """
        sampler = {"type": "stratified", "sample_count": 1, "jitter": False}
        seen = "position:position,normal:sh_normal,part:uv"
        values = self._integrate(camera, {"type": "aov", "aovs": seen}, sampler, 1, 0)
        position, normals = values[..., :3].astype(np.float64), values[..., 3:6]
        parts = values[..., 6].round().astype(np.uint8)
        hit = parts > 0
        depth = np.where(hit, np.linalg.norm(position - camera.position, axis=-1), np.nan).astype(np.float32)
        return depth, np.where(hit[..., None], normals, np.nan), parts

    def picture(self, camera: Camera, samples: int, seed: int = 0) -> np.ndarray:
        """A path-traced picture, each pixel the mean over its area; the light itself is not shown.

        Args:
            camera: Of the picture's size.
            samples: Light paths per pixel; rounded up to `whole_grid`.
            seed: Of the noise; the same seed gives the same picture on any number of cores.

        Returns:
            (H, W, 3) float32 sRGB on black.

        Raises:
            ValueError: the camera's fx and fy differ.
        """
        integrator = {"type": "path", "max_depth": BOUNCES, "hide_emitters": True}
        samples = whole_grid(samples)
        sampler = {"type": "multijitter", "sample_count": samples}
        return linear_to_srgb(self._integrate(camera, integrator, sampler, samples, seed)[..., :3]).astype(np.float32)

    def _integrate(
        self, camera: Camera, integrator: dict[str, Any], sampler: dict[str, Any], samples: int, seed: int
    ) -> np.ndarray:
        if abs(camera.fx - camera.fy) > 1e-6 * camera.fx:
            raise ValueError(f"Mitsuba's pixels are square, but fx is {camera.fx} and fy {camera.fy}")
        mi = self._mi
        mi.set_variant(VARIANT)
        sensor = perspective_sensor(mi, camera, "rgb", sampler)
        scheme = mi.load_dict(integrator | {"block_size": BLOCK})
        drawn = mi.render(self._scene, sensor=mi.load_dict(sensor), integrator=scheme, spp=samples, seed=seed)
        return np.array(drawn)
