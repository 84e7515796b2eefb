"""Vertices of skin whose places and colours follow shape, texture and light, for fitting all of them together.

A vertex's normal decides how bright it is, so shading tells of shape; and a texture or a light that is held while the
shape is fitted keeps what they took over from its errors.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
import torch.nn.functional as F

from gazenerf.head_model.interface import FACE, HeadMesh, HeadModel
from gazenerf.head_model.points import double
from gazenerf.photographs.looks import LitVertices


class LitSkin(NamedTuple):
    """N vertices and two neighbours of each.

    Attributes:
        vertices: (3, N) the vertices, their first and their second neighbours.
        drawn_normals: (N, 3) of the mesh.
        normals: (N, 3) the same in the frame that a vertex and its neighbours span (`_frames`), with which they turn.
        lit: Their albedo.
    """

    vertices: np.ndarray
    drawn_normals: torch.Tensor
    normals: torch.Tensor
    lit: LitVertices

    @staticmethod
    def of(model: HeadModel, mesh: HeadMesh, vertices: np.ndarray) -> LitSkin:
        """Of vertices (N,) of the skin of a posed head."""
        corners = np.concatenate([vertices[None], _neighbours(mesh, vertices)])
        frames = _frames(double(mesh.vertices[corners]))
        drawn = double(mesh.normals[vertices])
        turned = torch.einsum("nij,nj->ni", frames, drawn)
        return LitSkin(corners, drawn, turned, LitVertices.of(model, vertices, mesh.occlusion))

    def colours(self, places: torch.Tensor, texture: torch.Tensor, light: torch.Tensor) -> torch.Tensor:
        """(N, 3) sRGB of the vertices where they and their neighbours are at places (3, N, 3)."""
        turned = torch.einsum("nij,ni->nj", _frames(places), self.normals)
        return self.lit.colours(turned, texture, light)


def _neighbours(mesh: HeadMesh, vertices: np.ndarray) -> np.ndarray:
    """(2, N) two neighbours of each vertex (N,) of the skin, seen from it as near to a right angle as there are."""
    faces = mesh.part_faces(FACE)
    place = np.full(len(mesh.vertices), -1)
    place[vertices] = np.arange(len(vertices))
    rings: list[set[int]] = [set() for _ in vertices]
    for face in faces[(place[faces] >= 0).any(axis=1)].tolist():
        for corner in face:
            if place[corner] >= 0:
                rings[place[corner]].update(face)
    found = np.empty((2, len(vertices)), int)
    for number, (vertex, ring) in enumerate(zip(vertices.tolist(), rings, strict=True)):
        others = np.array(sorted(ring - {vertex}))
        ways = mesh.vertices[others] - mesh.vertices[vertex]
        ways = ways / np.maximum(np.linalg.norm(ways, axis=1, keepdims=True), 1e-9)
        sines = np.linalg.norm(np.cross(ways[:, None], ways[None]), axis=-1)
        found[:, number] = others[list(np.unravel_index(sines.argmax(), sines.shape))]
    return found


def _frames(places: torch.Tensor) -> torch.Tensor:
    """(N, 3, 3) rows: towards the first neighbour, across within the surface, and out of it, of places (3, N, 3)."""
    first = F.normalize(places[1] - places[0], dim=-1)
    out = F.normalize(torch.cross(first, places[2] - places[0], dim=-1), dim=-1)
    return torch.stack([first, torch.cross(out, first, dim=-1), out], dim=-2)
