"""Reference views by Mitsuba 3: rays through the exact pixel centres, and a path-traced picture.

Mitsuba's integrators jitter their samples, so depth, normals and parts come from rays shot one by
one; only the picture is integrated.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from gazenerf.data.mitsuba_scene import CORNEA_INDEX, VARIANT, perspective_sensor
from gazenerf.geometry import Camera
from gazenerf.head_model.interface import FACE, HeadMesh
from gazenerf.head_model.shading import linear_to_srgb, spherical_harmonics

PATHS = 16
"""Light paths a pixel of the picture."""


class MitsubaScene:
    """A head in a Mitsuba scene.

    Args:
        mesh: The head.
        illumination: (27,) radiance in spherical harmonics, the light of pictures; None when none are wanted.
    """

    def __init__(self, mesh: HeadMesh, illumination: np.ndarray | None = None) -> None:
        import mitsuba as mi

        mi.set_variant(VARIANT)
        self._mi: Any = mi
        self._bounds = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
        scene = {"type": "scene"} | {f"part{part}": self._shape(mesh, int(part)) for part in np.unique(mesh.face_part)}
        if illumination is not None:
            scene["light"] = self._light(np.asarray(illumination, dtype=np.float64))
        self._scene = mi.load_dict(scene)

    def _shape(self, mesh: HeadMesh, part: int) -> Any:
        mi = self._mi
        used, faces = np.unique(mesh.part_faces(part), return_inverse=True)
        colour = {"type": "mesh_attribute", "name": "vertex_color"}
        skin = {"type": "twosided", "skin": {"type": "diffuse", "reflectance": colour}}
        eye = {"type": "principled", "base_color": colour, "roughness": 0.15, "eta": CORNEA_INDEX}
        properties = mi.Properties()
        properties["bsdf"] = mi.load_dict(skin if part == FACE else eye)
        shape = mi.Mesh(f"part{part}", len(used), faces.size // 3, properties, has_vertex_normals=True)
        shape.add_attribute("vertex_color", 3, np.clip(mesh.albedo[used], 0.0, 1.0).astype(np.float32).ravel())
        values = mi.traverse(shape)
        values["vertex_positions"] = mesh.vertices[used].astype(np.float32).ravel()
        values["vertex_normals"] = mesh.normals[used].astype(np.float32).ravel()
        values["faces"] = faces.astype(np.uint32).ravel()
        values.update()
        return shape

    def _light(self, illumination: np.ndarray, rows: int = 32) -> dict[str, Any]:
        v, u = np.meshgrid((np.arange(rows) + 0.5) / rows, (np.arange(2 * rows) + 0.5) / (2 * rows), indexing="ij")
        theta, phi = np.pi * v, 2.0 * np.pi * u
        directions = np.stack([np.sin(theta) * np.sin(phi), np.cos(theta), -np.sin(theta) * np.cos(phi)], axis=-1)
        radiance = np.maximum(spherical_harmonics(directions) @ illumination.reshape(9, 3), 0.0)
        return {"type": "envmap", "bitmap": self._mi.Bitmap(radiance.astype(np.float32))}

    def geometry(self, camera: Camera) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Depth (H, W) float32, shading normals (H, W, 3) float32, both NaN off the mesh, and parts (H, W) uint8."""
        mi = self._mi
        rays_o, rays_d = camera.rays()
        depth = np.full(rays_d.shape[:2], np.nan, np.float32)
        normals = np.full(rays_d.shape, np.nan, np.float32)
        parts = np.zeros(depth.shape, np.uint8)
        origin = mi.Point3f(*camera.position.tolist())
        for row, column in np.argwhere(_meets_box(rays_o, rays_d, *self._bounds)):
            hit = self._scene.ray_intersect(mi.Ray3f(origin, mi.Vector3f(*rays_d[row, column].tolist())))
            if hit.is_valid():
                depth[row, column] = hit.t
                normals[row, column] = hit.sh_frame.n
                parts[row, column] = int(hit.shape.id().removeprefix("part")) + 1
        return depth, normals, parts

    def picture(self, camera: Camera) -> np.ndarray:
        """(H, W, 3) float32 path-traced sRGB picture on black; the light itself is not shown."""
        mi = self._mi
        sampler = {"type": "multijitter", "sample_count": PATHS, "seed": 0}
        sensor = mi.load_dict(perspective_sensor(mi, camera, "rgba", sampler))
        integrator = mi.load_dict({"type": "path", "max_depth": 3, "hide_emitters": True})
        rgba = np.array(mi.render(self._scene, sensor=sensor, integrator=integrator, spp=PATHS))
        return linear_to_srgb(rgba[..., :3]).astype(np.float32)


def _meets_box(rays_o: np.ndarray, rays_d: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    slope = np.where(np.abs(rays_d) < 1e-12, 1e-12, rays_d)
    a, b = (lower - rays_o) / slope, (upper - rays_o) / slope
    return np.minimum(a, b).max(axis=-1) <= np.maximum(a, b).min(axis=-1)
