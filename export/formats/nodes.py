"""Scenes as files hold them: nodes with meshes, textures and morphs, and clips that move them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import trimesh

IDENTITY = (0.0, 0.0, 0.0, 1.0)


@dataclass(frozen=True)
class Texture:
    """A base colour for a mesh.

    Attributes:
        uv: (V, 2) from the picture's upper left corner, v down.
        png: The bytes of an sRGB PNG file.
    """

    uv: np.ndarray
    png: bytes


@dataclass(frozen=True)
class Morph:
    """A shape that a mesh can be blended into (a morph target).

    Attributes:
        name: Its name.
        offsets: (V, 3) from the mesh's vertices, metres; mostly zero.
        normals: (V, 3) change of the mesh's unit normals.
    """

    name: str
    offsets: np.ndarray
    normals: np.ndarray


@dataclass(frozen=True)
class Node:
    """A node of a scene, metres.

    Attributes:
        name: Its name.
        mesh: Geometry about the node's origin, None for a group.
        texture: Base colour of the mesh; vertex colours are left out where it is given.
        translation: (3,) of the node's origin in its parent.
        rotation: Quaternion x, y, z, w.
        roughness: Of the material; metallic is always 0.
        children: Nodes below.
        morphs: Shapes of the mesh, none of which is blended in at rest.
        extras: More about the node, as JSON holds it.
    """

    name: str
    mesh: trimesh.Trimesh | None = None
    translation: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rotation: tuple[float, float, float, float] = IDENTITY
    roughness: float = 0.8
    children: tuple[Node, ...] = ()
    texture: Texture | None = None
    morphs: tuple[Morph, ...] = ()
    extras: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Animation:
    """Rotations of nodes and blends of their morphs over time.

    Attributes:
        name: Its name.
        times: (T,) seconds, ascending.
        rotations: Node name to (T, 4) quaternions x, y, z, w.
        weights: Node name to (T, M) shares of its M morphs.
    """

    name: str
    times: np.ndarray
    rotations: dict[str, np.ndarray]
    weights: dict[str, np.ndarray] = field(default_factory=dict)
