"""Wavefront OBJ with a material and a picture."""

from __future__ import annotations

import numpy as np
import trimesh


def textured_obj(mesh: trimesh.Trimesh, uv: np.ndarray, name: str) -> str:
    """The text of an .obj file whose material lies in `NAME.mtl` beside it.

    Args:
        mesh: With vertex normals.
        uv: (V, 2), v down; OBJ has v up.
        name: Of the object, its material and its files, without a suffix.
    """
    lines = [f"mtllib {name}.mtl", f"o {name}", f"usemtl {name}"]
    lines += [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in np.asarray(mesh.vertices)]
    lines += [f"vt {u:.7g} {v:.7g}" for u, v in np.stack([uv[:, 0], 1.0 - uv[:, 1]], axis=1)]
    lines += [f"vn {x:.6g} {y:.6g} {z:.6g}" for x, y, z in np.asarray(mesh.vertex_normals)]
    lines += [f"f {a}/{a}/{a} {b}/{b}/{b} {c}/{c}/{c}" for a, b, c in np.asarray(mesh.faces) + 1]
    return "\n".join(lines) + "\n"


def material(name: str) -> str:
    """The text of the .mtl file that `textured_obj` names: the picture `NAME.png`, not shiny."""
    return f"newmtl {name}\nKa 0 0 0\nKd 1 1 1\nKs 0 0 0\nd 1\nillum 1\nmap_Kd {name}.png\n"
