"""Binary glTF 2.0: coloured or textured nodes in a hierarchy, and rotations and morphs that move them.

trimesh writes static scenes with 8-bit colours; a rig needs animation, and 8 linear bits band in
dark skin. Colours are written as 16-bit linear values.
"""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from gazenerf import __version__
from gazenerf.export.appearance.colours import linear_from_srgb, vertex_colours
from gazenerf.export.formats.nodes import IDENTITY, Animation, Node
from gazenerf.export.formats.quantized import EXTENSIONS, signed, unsigned, webp

FLOAT, UINT32, UINT16, INT16, INT8 = 5126, 5125, 5123, 5122, 5120
VERTICES, INDICES = 34962, 34963
LINEAR, MIPMAPPED, CLAMPED = 9729, 9987, 33071

RESTART = 65_535
"""The 16-bit index that no vertex may have."""


@dataclass
class _Writer:
    tree: dict[str, Any]
    compressed: bool = False
    data: bytearray = field(default_factory=bytearray)

    def accessor(
        self, values: np.ndarray, component: int, kind: str, *, target: int | None = None, limits: bool = False,
        normalized: bool = False, padded: bool = False,
    ) -> int:  # fmt: skip
        """Append an array to the buffer, of a `padded` one all but the last column counts; its accessor's index."""
        entry: dict[str, Any] = {
            "bufferView": self.view(values.tobytes(), target),
            "componentType": component,
            "count": len(values),
            "type": kind,
        }
        if padded:
            self.tree["bufferViews"][-1]["byteStride"] = values[0].nbytes
            values = values[:, :-1]
        if normalized:
            entry["normalized"] = True
        if limits:
            flat = values.reshape(len(values), -1)
            entry |= {"min": flat.min(axis=0).tolist(), "max": flat.max(axis=0).tolist()}
        self.tree["accessors"].append(entry)
        return len(self.tree["accessors"]) - 1

    def sparse(self, values: np.ndarray) -> int:
        """Append (V, 3) values that are mostly zero; their accessor's index."""
        rows = np.flatnonzero(np.any(values != 0.0, axis=1))
        rows = rows if len(rows) else np.array([0])
        entry = {
            "componentType": FLOAT,
            "count": len(values),
            "type": "VEC3",
            "min": values.min(axis=0).tolist(),
            "max": values.max(axis=0).tolist(),
            "sparse": {
                "count": len(rows),
                # VTK's reader allocates without end where the offsets, 0 by default, are left out
                "indices": {
                    "bufferView": self.view(rows.astype("<u4").tobytes()),
                    "byteOffset": 0,
                    "componentType": UINT32,
                },
                "values": {"bufferView": self.view(values[rows].tobytes()), "byteOffset": 0},
            },
        }
        self.tree["accessors"].append(entry)
        return len(self.tree["accessors"]) - 1

    def view(self, data: bytes, target: int | None = None) -> int:
        """Append bytes to the buffer, on a boundary of four; their view's index."""
        self.data.extend(b"\0" * (-len(self.data) % 4))
        view = {"buffer": 0, "byteOffset": len(self.data), "byteLength": len(data)}
        self.tree["bufferViews"].append(view if target is None else view | {"target": target})
        self.data.extend(data)
        return len(self.tree["bufferViews"]) - 1

    def texture(self, png: bytes, name: str) -> int:
        """Append a picture and how it is looked up; its texture's index."""
        for key in ("images", "samplers", "textures"):
            self.tree.setdefault(key, [])
        kind, data = ("image/webp", webp(png)) if self.compressed else ("image/png", png)
        self.tree["images"].append({"name": name, "mimeType": kind, "bufferView": self.view(data)})
        if not self.tree["samplers"]:
            self.tree["samplers"].append(
                {"magFilter": LINEAR, "minFilter": MIPMAPPED, "wrapS": CLAMPED, "wrapT": CLAMPED}
            )
        source = {"source": len(self.tree["images"]) - 1}
        if self.compressed:
            source = {"extensions": {"EXT_texture_webp": source}}
        self.tree["textures"].append({"sampler": 0, **source})
        return len(self.tree["textures"]) - 1

    def shape(self, vertices: np.ndarray, normals: np.ndarray) -> dict[str, int]:
        """Append vertices (V, 3), compressed ones in [-1, 1], and unit normals (V, 3); attribute to accessor."""
        kind, target = "VEC3", VERTICES
        if not self.compressed:
            return {
                "POSITION": self.accessor(vertices.astype("<f4"), FLOAT, kind, target=target, limits=True),
                "NORMAL": self.accessor(normals.astype("<f4"), FLOAT, kind, target=target),
            }
        places, directions = signed(vertices, "<i2"), signed(normals, "<i1")
        return {
            "POSITION": self.accessor(places, INT16, kind, target=target, limits=True, normalized=True, padded=True),
            "NORMAL": self.accessor(directions, INT8, kind, target=target, normalized=True, padded=True),
        }

    def mesh(self, node: Node, scale: float) -> int:
        """Append the mesh of a node, whose vertices are divided by `scale`; its index."""
        mesh, name, texture = node.mesh, node.name, node.texture
        assert mesh is not None
        normals = np.asarray(mesh.vertex_normals, dtype=np.float64)
        normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
        attributes = self.shape(np.asarray(mesh.vertices) / scale, normals)
        look: dict[str, Any] = {"metallicFactor": 0.0, "roughnessFactor": node.roughness}
        colours = vertex_colours(mesh)
        if texture is not None:
            uv, component = np.asarray(texture.uv, dtype="<f4"), FLOAT
            if self.compressed:
                uv, component = unsigned(uv, "<u2"), UINT16
            attributes["TEXCOORD_0"] = self.accessor(uv, component, "VEC2", target=VERTICES, normalized=self.compressed)
            look["baseColorTexture"] = {"index": self.texture(texture.png, name)}
        elif colours is not None:
            rgba = np.ones((len(colours), 4))
            rgba[:, :3] = linear_from_srgb(colours[:, :3] / 255.0)
            attributes["COLOR_0"] = self.accessor(
                np.round(65535.0 * rgba).astype("<u2"), UINT16, "VEC4", target=VERTICES, normalized=True
            )
        width, component = ("<u2", UINT16) if len(mesh.vertices) < RESTART else ("<u4", UINT32)
        indices = self.accessor(np.asarray(mesh.faces, dtype=width).reshape(-1), component, "SCALAR", target=INDICES)
        self.tree["materials"].append({"name": name, "pbrMetallicRoughness": look})
        primitive = {"attributes": attributes, "indices": indices, "material": len(self.tree["materials"]) - 1}
        entry: dict[str, Any] = {"name": name, "primitives": [primitive]}
        if node.morphs:
            primitive["targets"] = [
                {
                    "POSITION": self.sparse((morph.offsets / scale).astype("<f4")),
                    "NORMAL": self.sparse(morph.normals.astype("<f4")),
                }
                for morph in node.morphs
            ]
            entry |= {
                "weights": [0.0] * len(node.morphs),
                "extras": {"targetNames": [morph.name for morph in node.morphs]},
            }
        self.tree["meshes"].append(entry)
        return len(self.tree["meshes"]) - 1

    def node(self, node: Node) -> int:
        """Append a node and those below; its index."""
        entry: dict[str, Any] = {"name": node.name}
        if node.mesh is not None:
            scale = float(np.abs(node.mesh.vertices).max()) if self.compressed else 1.0
            entry["mesh"] = self.mesh(node, scale)
            if self.compressed:
                entry["scale"] = [scale] * 3
        if any(node.translation):
            entry["translation"] = [float(value) for value in node.translation]
        if tuple(node.rotation) != IDENTITY:
            entry["rotation"] = [float(value) for value in node.rotation]
        if node.extras:
            entry["extras"] = node.extras
        if node.children:
            entry["children"] = [self.node(child) for child in node.children]
        self.tree["nodes"].append(entry)
        return len(self.tree["nodes"]) - 1

    def animation(self, animation: Animation) -> dict[str, Any]:
        """Append an animation's samples; its entry."""
        names = [node["name"] for node in self.tree["nodes"]]
        time = self.accessor(animation.times.astype("<f4"), FLOAT, "SCALAR", limits=True)
        entry: dict[str, Any] = {"name": animation.name, "samplers": [], "channels": []}
        moved = [(name, "rotation", turns, "VEC4") for name, turns in animation.rotations.items()]
        moved += [(name, "weights", shares.reshape(-1), "SCALAR") for name, shares in animation.weights.items()]
        for name, path, values, kind in moved:
            output = self.accessor(values.astype("<f4"), FLOAT, kind)
            entry["channels"].append(
                {"sampler": len(entry["samplers"]), "target": {"node": names.index(name), "path": path}}
            )
            entry["samplers"].append({"input": time, "output": output, "interpolation": "LINEAR"})
        return entry


def glb(root: Node, animations: tuple[Animation, ...] = (), *, compressed: bool = False) -> bytes:
    """A scene as the bytes of a .glb file.

    Args:
        root: The scene's only root.
        animations: Clips; they name nodes under `root`.
        compressed: Write 16-bit positions about each node's origin, 8-bit normals and WebP textures
            (KHR_mesh_quantization, EXT_texture_webp). Nodes with a mesh get a uniform scale, so they must have no
            children.

    Raises:
        ValueError: a clip names a node that is not there.
    """
    writer = _Writer(
        {
            "asset": {"version": "2.0", "generator": f"gazenerf {__version__}"},
            "scene": 0,
            "scenes": [{}],
            **{key: [] for key in ("nodes", "meshes", "materials", "accessors", "bufferViews")},
        },
        compressed,
    )
    writer.tree["scenes"][0]["nodes"] = [writer.node(root)]
    if animations:
        writer.tree["animations"] = [writer.animation(animation) for animation in animations]
    if compressed:
        names = [name for name in EXTENSIONS if name != "EXT_texture_webp" or "textures" in writer.tree]
        writer.tree |= {"extensionsUsed": names, "extensionsRequired": names}
    writer.data.extend(b"\0" * (-len(writer.data) % 4))
    writer.tree["buffers"] = [{"byteLength": len(writer.data)}]
    text = json.dumps(writer.tree, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text
    chunks += struct.pack("<I4s", len(writer.data), b"BIN\0") + bytes(writer.data)
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks
