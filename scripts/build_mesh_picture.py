"""Meshes of one subject by several fields under a hard light, a row each: what their surfaces are like.

python scripts/build_mesh_picture.py docs/images/hard-light.webp --subject noa --checkpoint portrait portrait-sdf
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path

os.environ.setdefault("PYOPENGL_PLATFORM", "egl")

import numpy as np
import pyrender
import trimesh
from PIL import Image
from scipy.spatial.transform import Rotation

import gazenerf
from gazenerf.export.options import MeshOptions
from gazenerf.export.part_mesh import extract_part

YAWS = (0.0, 45.0, -80.0)
"""Degrees, from which each mesh is seen."""

LIGHT_YAW, LIGHT_PITCH = 55.0, -25.0
"""Degrees by which the light is turned from the camera."""


def picture(meshes: list[trimesh.Trimesh], yaw: float, size: int) -> np.ndarray:
    """(size, size, 3) uint8 of grey meshes in world units, lit from the side."""
    scene = pyrender.Scene(bg_color=[0.12, 0.12, 0.14, 1.0], ambient_light=[0.06] * 3)
    material = pyrender.MetallicRoughnessMaterial(
        baseColorFactor=[0.75, 0.7, 0.66, 1.0], metallicFactor=0.0, roughnessFactor=0.55
    )
    for mesh in meshes:
        grey = trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_normals=mesh.vertex_normals, process=False)
        scene.add(pyrender.Mesh.from_trimesh(grey, material=material, smooth=True))
    camera, light = np.eye(4), np.eye(4)
    camera[:3, :3] = Rotation.from_euler("y", yaw, degrees=True).as_matrix()
    camera[:3, 3] = camera[:3, :3] @ [0.0, -0.2, 12.0]
    light[:3, :3] = Rotation.from_euler("YX", [yaw + LIGHT_YAW, LIGHT_PITCH], degrees=True).as_matrix()
    scene.add(pyrender.PerspectiveCamera(yfov=np.radians(15.0)), pose=camera)
    scene.add(pyrender.DirectionalLight(intensity=4.5), pose=light)
    renderer = pyrender.OffscreenRenderer(size, size)
    try:
        return renderer.render(scene)[0]
    finally:
        renderer.delete()


def main() -> None:
    """See the module."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--subject", default="noa")
    parser.add_argument("--checkpoint", nargs="+", required=True)
    parser.add_argument("--size", type=int, default=320, help="pixels of one picture (default: 320)")
    arguments = parser.parse_args()
    rows = []
    for checkpoint in arguments.checkpoint:
        bound = gazenerf.load(arguments.subject, checkpoint).at(gazenerf.Gaze())
        meshes = [extract_part(bound, part, MeshOptions(colours=False)).mesh for part in ("face", "eyes")]
        rows.append(np.hstack([picture(meshes, yaw, arguments.size) for yaw in YAWS]))
    Image.fromarray(np.vstack(rows)).save(arguments.out, quality=85)


if __name__ == "__main__":
    main()
