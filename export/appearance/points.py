"""Coloured points sampled on a surface."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh

from gazenerf.errors import UserError
from gazenerf.export.appearance.colours import PartPicture, blend_colours

MAX_POINTS = 20_000_000
SEED = 0


@dataclass(frozen=True)
class PointCloud:
    """Points on a surface.

    Attributes:
        points: (N, 3) positions.
        normals: (N, 3) unit, outward.
        colours: (N, 3) uint8 sRGB, None where there are none.
    """

    points: np.ndarray
    normals: np.ndarray
    colours: np.ndarray | None


def check_points(count: int) -> None:
    """Raise UserError where a cloud cannot have so many points."""
    if not 1 <= count <= MAX_POINTS:
        raise UserError(f"--points goes from 1 to {MAX_POINTS:,}, got {count:,}")


def sample_points(mesh: trimesh.Trimesh, count: int, pictures: list[PartPicture] | None = None) -> PointCloud:
    """Points spread evenly over a mesh's area, the same ones every time.

    Args:
        mesh: World units, with vertex normals.
        count: How many.
        pictures: What colours are blended from, see `gazenerf.export.appearance.colours.blend_colours`; None for none.

    Raises:
        UserError: an impossible count.
    """
    check_points(count)
    points, face = (np.asarray(array) for array in trimesh.sample.sample_surface(mesh, count, seed=SEED)[:2])
    weights = trimesh.triangles.points_to_barycentric(np.asarray(mesh.triangles)[face], points)
    normals = np.einsum("nk,nkc->nc", weights, np.asarray(mesh.vertex_normals)[np.asarray(mesh.faces)[face]])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    colours = None if pictures is None else blend_colours(pictures, mesh, points, normals)[0]
    return PointCloud(points, normals, colours)


def write_points(cloud: PointCloud, scale: float, path: Path) -> None:
    """Write a binary PLY: x y z, nx ny nz, and red green blue where there are colours.

    Args:
        cloud: The points.
        scale: Positions are multiplied by it, `metres_per_unit` for metres.
        path: A file in an existing folder.
    """
    names = ["x", "y", "z", "nx", "ny", "nz"]
    kinds = [("float", "<f4")] * 6
    columns = [*(scale * cloud.points).T, *cloud.normals.T]
    if cloud.colours is not None:
        names += ["red", "green", "blue"]
        kinds += [("uchar", "u1")] * 3
        columns += list(cloud.colours.T)
    table = np.empty(len(cloud.points), dtype=[(name, kind) for name, (_, kind) in zip(names, kinds, strict=True)])
    for name, column in zip(names, columns, strict=True):
        table[name] = column
    properties = [f"property {kind} {name}" for name, (kind, _) in zip(names, kinds, strict=True)]
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(table)}", *properties, "end_header", ""]
    path.write_bytes("\n".join(lines).encode("ascii") + table.tobytes())
