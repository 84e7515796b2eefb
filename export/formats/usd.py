"""Scenes as USDZ packages, through Pixar's usd-core (optional)."""

from __future__ import annotations

import tempfile
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from gazenerf.errors import UserError
from gazenerf.export.appearance.colours import linear_from_srgb, vertex_colours
from gazenerf.export.formats.nodes import Animation, Node

RATE = 24.0
"""Time codes a second."""


def check_usd() -> None:
    """Raise UserError where usd-core is not installed."""
    try:
        import pxr  # noqa: F401
    except ImportError as error:
        raise UserError("usdz files need usd-core; pip install 'gazenerf[usd]'") from error


def usdz(root: Node, clips: tuple[Animation, ...] = ()) -> bytes:
    """A scene as the bytes of a .usdz file: metres, Y up, textures inside.

    USD has no named clips: the first clip's rotations become the timeline. Morphs are left out.

    Args:
        root: As for `gazenerf.export.formats.gltf.glb`.
        clips: As for `gazenerf.export.formats.gltf.glb`.

    Raises:
        UserError: usd-core is not installed.
    """
    check_usd()
    Usd, UsdGeom, UsdUtils = (import_module(f"pxr.{name}") for name in ("Usd", "UsdGeom", "UsdUtils"))

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        stage: Any = Usd.Stage.CreateNew(str(folder / "scene.usdc"))
        UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
        UsdGeom.SetStageMetersPerUnit(stage, 1.0)
        top = _Stage(stage, folder, clips[0] if clips else None).add(root, "")
        stage.SetDefaultPrim(top)
        if clips:
            stage.SetTimeCodesPerSecond(RATE)
            stage.SetFramesPerSecond(RATE)
            stage.SetStartTimeCode(0.0)
            stage.SetEndTimeCode(float(clips[0].times[-1] * RATE))
        stage.GetRootLayer().Save()
        package = folder / "scene.usdz"
        if not UsdUtils.CreateNewUsdzPackage(str(folder / "scene.usdc"), str(package)):
            raise UserError("usd-core could not write the package; is the disk full?")
        return package.read_bytes()


class _Stage:
    """A stage under construction, with the folder that holds its textures."""

    def __init__(self, stage: Any, folder: Path, clip: Animation | None) -> None:
        self.stage, self.folder, self.clip = stage, folder, clip

    def add(self, node: Node, parent: str) -> Any:
        """Add a node and those below; its prim."""
        UsdGeom = import_module("pxr.UsdGeom")

        path = f"{parent}/{node.name}"
        frame = UsdGeom.Xform.Define(self.stage, path)
        if any(node.translation):
            frame.AddTranslateOp().Set(tuple(map(float, node.translation)))
        turns = {} if self.clip is None else self.clip.rotations
        turn = frame.AddOrientOp()
        turn.Set(_quaternion(node.rotation))
        if self.clip is not None and node.name in turns:
            for time, rotation in zip(self.clip.times, turns[node.name], strict=True):
                turn.Set(_quaternion(rotation), float(time * RATE))
        if node.mesh is not None:
            self._mesh(node, path)
        for child in node.children:
            self.add(child, path)
        return frame.GetPrim()

    def _mesh(self, node: Node, path: str) -> None:
        Gf, Sdf, Vt = (import_module(f"pxr.{name}") for name in ("Gf", "Sdf", "Vt"))
        UsdGeom, UsdShade = import_module("pxr.UsdGeom"), import_module("pxr.UsdShade")

        mesh = node.mesh
        assert mesh is not None
        shape = UsdGeom.Mesh.Define(self.stage, f"{path}/{node.name}")
        vertices = np.asarray(mesh.vertices, np.float32)
        shape.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(vertices))
        shape.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(mesh.faces), 3, np.int32)))
        shape.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(np.asarray(mesh.faces, np.int32).reshape(-1)))
        shape.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(np.array(mesh.vertex_normals, np.float32)))
        shape.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
        shape.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
        shape.CreateExtentAttr([Gf.Vec3f(*map(float, corner)) for corner in (vertices.min(0), vertices.max(0))])
        looks = f"{path}/{node.name}_material"
        material = UsdShade.Material.Define(self.stage, looks)
        surface = _shader(self.stage, f"{looks}/surface", "UsdPreviewSurface")
        surface.CreateInput("metallic", Sdf.ValueTypeNames.Float).Set(0.0)
        surface.CreateInput("roughness", Sdf.ValueTypeNames.Float).Set(node.roughness)
        colour = surface.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f)
        primvars = UsdGeom.PrimvarsAPI(shape)
        colours = vertex_colours(mesh)
        if node.texture is not None:
            st = primvars.CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, UsdGeom.Tokens.vertex)
            uv = np.asarray(node.texture.uv, np.float32) * np.array([1, -1], np.float32) + np.array([0, 1], np.float32)
            st.Set(Vt.Vec2fArray.FromNumpy(uv))
            (self.folder / f"{node.name}.png").write_bytes(node.texture.png)
            reader = _shader(self.stage, f"{looks}/st", "UsdPrimvarReader_float2")
            reader.CreateInput("varname", Sdf.ValueTypeNames.String).Set("st")
            picture = _shader(self.stage, f"{looks}/picture", "UsdUVTexture")
            picture.CreateInput("file", Sdf.ValueTypeNames.Asset).Set(f"./{node.name}.png")
            picture.CreateInput("sourceColorSpace", Sdf.ValueTypeNames.Token).Set("sRGB")
            for wrap in ("wrapS", "wrapT"):
                picture.CreateInput(wrap, Sdf.ValueTypeNames.Token).Set("clamp")
            picture.CreateInput("st", Sdf.ValueTypeNames.Float2).ConnectToSource(
                reader.CreateOutput("result", Sdf.ValueTypeNames.Float2)
            )
            colour.ConnectToSource(picture.CreateOutput("rgb", Sdf.ValueTypeNames.Float3))
        elif colours is not None:
            linear = linear_from_srgb(colours[:, :3] / 255.0).astype(np.float32)
            shape.CreateDisplayColorPrimvar(UsdGeom.Tokens.vertex).Set(Vt.Vec3fArray.FromNumpy(linear))
            reader = _shader(self.stage, f"{looks}/colour", "UsdPrimvarReader_float3")
            reader.CreateInput("varname", Sdf.ValueTypeNames.String).Set("displayColor")
            colour.ConnectToSource(reader.CreateOutput("result", Sdf.ValueTypeNames.Float3))
        material.CreateSurfaceOutput().ConnectToSource(surface.CreateOutput("surface", Sdf.ValueTypeNames.Token))
        UsdShade.MaterialBindingAPI.Apply(shape.GetPrim()).Bind(material)


def _shader(stage: Any, path: str, kind: str) -> Any:
    shader = import_module("pxr.UsdShade").Shader.Define(stage, path)
    shader.CreateIdAttr(kind)
    return shader


def _quaternion(rotation: Any) -> Any:
    x, y, z, w = map(float, rotation)
    return import_module("pxr.Gf").Quatf(w, x, y, z)
