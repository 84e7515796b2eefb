"""A texture for a mesh: unwrapped by xatlas, baked from the field's own pictures."""

from __future__ import annotations

import io
from dataclasses import dataclass

import cv2
import numpy as np
import trimesh
from PIL import Image

from gazenerf.errors import UserError
from gazenerf.export.appearance.colours import PartPicture, blend_colours
from gazenerf.export.surface.densities import MEMORY_SHARE, available_memory

SIZES = (1024, 2048, 4096)

MAX_FACES = 20_000
"""Faces that a mesh is reduced to before it is unwrapped, where nothing else is asked for."""

PADDING = 4
"""Texels between charts."""

CHART_COST = 8.0
"""How far xatlas may bend a chart; its own 2 cuts marching-cubes surfaces into more charts, for longer."""

BLOCK = 1_000
"""Faces, at most, that xatlas cuts into charts together: its time goes with more than the number of faces, and it works
on several blocks at once. A block's border is a seam like any other."""

CANDIDATES = 2**22
"""Texels that are tested against triangles at once."""


@dataclass(frozen=True)
class TexturedMesh:
    """A mesh with one base-colour texture.

    Attributes:
        mesh: World units, vertex normals, vertices doubled along seams, no vertex colours.
        uv: (V, 2) float32 in [0, 1] from the picture's upper left corner, v down, as glTF has it.
        image: (S, S, 3) uint8 sRGB, row 0 on top.
        charts: Pieces of the unwrapped surface.
        covered: Share of the picture that charts cover.
        seen: Share of those texels that some view sees.
    """

    mesh: trimesh.Trimesh
    uv: np.ndarray
    image: np.ndarray
    charts: int
    covered: float
    seen: float

    def png(self) -> bytes:
        """The picture as the bytes of a PNG file."""
        buffer = io.BytesIO()
        Image.fromarray(self.image).save(buffer, "png")
        return buffer.getvalue()


BYTES_A_TEXEL = 100
"""Peak bytes per texel while a texture is painted (measured, rounded up)."""


def check_texture(size: int) -> None:
    """Raise UserError where a texture cannot have a size, or would not fit in memory."""
    if size not in SIZES:
        raise UserError(f"--texture is {', '.join(map(str, SIZES[:-1]))} or {SIZES[-1]}, got {size}")
    needed, there = size * size * BYTES_A_TEXEL, available_memory()
    if needed > MEMORY_SHARE * there:
        raise UserError(
            f"a texture of {size} needs about {needed / 2**30:.1f} GiB, {there / 2**30:.1f} GiB are free; "
            "give a smaller --texture"
        )


def bake_texture(mesh: trimesh.Trimesh, pictures: list[PartPicture], size: int) -> TexturedMesh:
    """Unwrap a mesh and paint its texture.

    Every texel inside a chart is a point of the surface and takes its colour as
    `gazenerf.export.appearance.colours.blend_colours` says; outside, the nearest chart's colour goes on, so that
    filtering meets no seam.

    Args:
        mesh: World units, with vertex normals.
        pictures: Of the same part as the mesh.
        size: Texels along a side, one of `SIZES`.

    Raises:
        UserError: another size, or a surface that cannot be unwrapped.
    """
    check_texture(size)
    unwrapped, uv, charts = unwrap(mesh, size)
    row, column, face, weights = texels(uv, np.asarray(unwrapped.faces), size)
    corners = np.asarray(unwrapped.faces)[face]
    points = np.einsum("nk,nkc->nc", weights, np.asarray(unwrapped.vertices, dtype=np.float32)[corners])
    normals = np.einsum("nk,nkc->nc", weights, np.asarray(unwrapped.vertex_normals, dtype=np.float32)[corners])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    colours, seen = blend_colours(pictures, mesh, points, normals)
    image = np.zeros((size, size, 3), np.uint8)
    inside = np.zeros((size, size), bool)
    image[row, column], inside[row, column] = colours, True
    return TexturedMesh(unwrapped, uv, dilate(image, inside), charts, float(inside.mean()), float(seen.mean()))


def unwrap(mesh: trimesh.Trimesh, size: int, block: int = BLOCK) -> tuple[trimesh.Trimesh, np.ndarray, int]:
    """A mesh cut into charts: the mesh with doubled vertices, its (V, 2) float32 uv, v down, and how many charts.

    Args:
        mesh: With vertex normals.
        size: Texels along a side.
        block: Faces, about, of the blocks that are cut into charts apart from each other; see `BLOCK`.

    Raises:
        UserError: xatlas finds no chart.
    """
    import xatlas

    atlas = xatlas.Atlas()
    vertices, normals = np.asarray(mesh.vertices, np.float32), np.asarray(mesh.vertex_normals, np.float32)
    blocks = face_blocks(mesh, block)
    used = [np.unique(np.asarray(mesh.faces)[own], return_inverse=True) for own in blocks]
    for index, numbered in used:
        atlas.add_mesh(vertices[index], numbered.reshape(-1, 3).astype(np.uint32), normals[index])
    charting = xatlas.ChartOptions()
    charting.max_cost = CHART_COST
    packing = xatlas.PackOptions()
    packing.resolution, packing.padding, packing.bilinear = size, PADDING, True
    atlas.generate(charting, packing)
    if atlas.atlas_count != 1 or atlas.chart_count == 0:
        raise UserError(f"the surface cannot be unwrapped into one texture of {size}; give a larger --texture")
    source, uv, faces, first = [], [], np.empty((len(mesh.faces), 3), np.int64), 0
    for i, own in enumerate(blocks):
        places, triangles, coordinates = atlas[i]
        source.append(used[i][0][places])
        uv.append(coordinates)
        faces[own] = triangles.astype(np.int64) + first
        first += len(places)
    chosen = np.concatenate(source)
    cut = trimesh.Trimesh(
        np.asarray(mesh.vertices)[chosen],
        faces,
        vertex_normals=np.asarray(mesh.vertex_normals)[chosen],
        process=False,
    )
    return cut, np.clip(np.concatenate(uv), 0.0, 1.0).astype(np.float32), int(atlas.chart_count)


def face_blocks(mesh: trimesh.Trimesh, most: int) -> list[np.ndarray]:
    """Numbers of the faces of each block: halved across the longest side until none holds more than `most` faces."""
    centres = np.asarray(mesh.triangles_center)
    waiting, blocks = [np.arange(len(centres))], []
    while waiting:
        own = waiting.pop()
        if len(own) <= most:
            blocks.append(own)
            continue
        axis = int(np.argmax(np.ptp(centres[own], axis=0)))
        order = np.argsort(centres[own, axis], kind="stable")
        waiting += [np.sort(own[order[: len(own) // 2]]), np.sort(own[order[len(own) // 2 :]])]
    return blocks


def texels(uv: np.ndarray, faces: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Which texels lie in triangles.

    Args:
        uv: (V, 2) in [0, 1], v down.
        faces: (F, 3).
        size: Texels along a side; texel (row, column) has its centre at (column + 0.5, row + 0.5) / size.

    Returns:
        row (N,), column (N,), face (N,), and float32 barycentric weights (N, 3) of the texels' centres.
    """
    corners = size * uv.astype(np.float64)[faces]
    low = np.clip(np.floor(corners.min(axis=1) - 0.5).astype(int), 0, size - 1)
    high = np.clip(np.ceil(corners.max(axis=1) - 0.5).astype(int), 0, size - 1)
    across, down = (high - low + 1).T
    edge_1, edge_2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = edge_1[:, 0] * edge_2[:, 1] - edge_1[:, 1] * edge_2[:, 0]
    area = np.where(np.abs(area) < 1e-12, np.inf, area)
    ends = np.cumsum(across * down)
    found, start = [], 0
    while start < len(faces):
        begun = ends[start - 1] if start else 0
        stop = max(start + 1, int(np.searchsorted(ends, begun + CANDIDATES)))
        counts = (across * down)[start:stop]
        face = np.repeat(np.arange(start, stop), counts)
        place = np.arange(len(face)) - np.repeat(np.cumsum(counts) - counts, counts)
        column, row = low[face, 0] + place % across[face], low[face, 1] + place // across[face]
        x, y = column + 0.5 - corners[face, 0, 0], row + 0.5 - corners[face, 0, 1]
        second = (x * edge_2[face, 1] - y * edge_2[face, 0]) / area[face]
        third = (y * edge_1[face, 0] - x * edge_1[face, 1]) / area[face]
        weights = np.stack([1.0 - second - third, second, third], axis=1)
        inside = (weights >= -1e-9).all(axis=1) & np.isfinite(area[face])
        found.append((row[inside], column[inside], face[inside], weights[inside].astype(np.float32)))
        start = stop
    row, column, face, weights = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return row, column, face, weights


def dilate(image: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """An image (H, W, 3) whose pixels that are not `inside` (H, W) take the nearest colour that is."""
    if not inside.any():
        return image
    outside = (~inside).astype(np.uint8)
    _, found = cv2.distanceTransformWithLabels(outside, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    labels = np.asarray(found, np.int64)
    colour = np.zeros((int(labels.max()) + 1, 3), np.uint8)
    colour[labels[inside]] = image[inside]
    return colour[labels]
