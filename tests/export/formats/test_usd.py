"""USDZ packages: what usd-core reads back is what was put in, and its own checker has nothing to say."""

from __future__ import annotations

import zipfile

import numpy as np
import pytest
import trimesh

import gazenerf.export.appearance.colours
from gazenerf.errors import UserError
from gazenerf.export import MeshOptions, mesh_subject
from gazenerf.export.formats.nodes import Animation, Node, Texture
from gazenerf.export.formats.usd import RATE, usdz
from gazenerf.heads.analytic import AnalyticField, AnalyticHead

pxr = pytest.importorskip("pxr", reason="usd-core is not installed: pip install 'gazenerf[usd]'")


def bind(gaze):
    return AnalyticField(gaze, sharpness=0.2)


@pytest.fixture
def package(tmp_path):
    """A textured ball that turns within a group, and a coloured box."""
    from gazenerf.export.appearance.eyeball_texture import eyeball_mesh

    ball, uv = eyeball_mesh(0.012)
    png = pytest.importorskip("PIL.Image").new("RGB", (8, 8), (200, 100, 50))
    png.save(tmp_path / "ball.png")
    box = trimesh.creation.box((0.1, 0.2, 0.3))
    box.visual.vertex_colors = np.tile([128, 64, 32, 255], (8, 1))
    texture = Texture(uv, (tmp_path / "ball.png").read_bytes())
    root = Node(
        "head",
        children=(Node("face", box), Node("eye_left", ball, (0.03, 0.01, 0.09), texture=texture, roughness=0.2)),
    )
    half = np.sqrt(0.5)
    clip = Animation("turn", np.array([0.0, 1.0]), {"eye_left": np.array([[0, 0, 0, 1.0], [0, half, 0, half]])})
    path = tmp_path / "scene.usdz"
    path.write_bytes(usdz(root, (clip,)))
    return path


def test_what_is_read_back_is_what_was_put_in(package):
    from pxr import Usd, UsdGeom, UsdShade

    stage = Usd.Stage.Open(str(package))
    assert UsdGeom.GetStageUpAxis(stage) == "Y" and UsdGeom.GetStageMetersPerUnit(stage) == 1.0
    assert stage.GetDefaultPrim().GetPath() == "/head"
    face = UsdGeom.Mesh(stage.GetPrimAtPath("/head/face/face"))
    assert np.allclose(np.ptp(np.array(face.GetPointsAttr().Get()), axis=0), [0.1, 0.2, 0.3])
    colour = np.array(face.GetDisplayColorAttr().Get())[0]
    assert np.allclose(colour, [0.2159, 0.0513, 0.0144], atol=1e-3)  # linear light
    frame = UsdGeom.Xformable(stage.GetPrimAtPath("/head/eye_left"))
    turned = np.array(frame.GetLocalTransformation(1.0 * RATE)).T
    assert np.allclose(turned[:3, 3], [0.03, 0.01, 0.09])
    assert np.allclose(turned[:3, :3] @ [0, 0, 1], [1, 0, 0], atol=1e-6)
    assert stage.GetEndTimeCode() == RATE
    material, _ = UsdShade.MaterialBindingAPI(stage.GetPrimAtPath("/head/eye_left/eye_left")).ComputeBoundMaterial()
    surface = material.ComputeSurfaceSource()[0]
    assert surface.GetInput("metallic").Get() == 0.0
    assert zipfile.ZipFile(package).namelist()[0].endswith(".usdc") and any(
        name.endswith("eye_left.png") for name in zipfile.ZipFile(package).namelist()
    )


def complaints(stage) -> list[str]:
    """What the validators of USD say of a stage."""
    validation = pytest.importorskip("pxr.UsdValidation", reason="this usd-core has no validators")
    validators = validation.ValidationRegistry().GetOrLoadAllValidators()
    return [error.GetMessage() for error in validation.ValidationContext(validators).Validate(stage)]


def test_the_validators_of_usd_have_nothing_to_say(package):
    from pxr import Usd, UsdShade

    stage = Usd.Stage.Open(str(package))
    assert complaints(stage) == []
    stage.SetEditTarget(stage.GetSessionLayer())
    stage.GetPrimAtPath("/head/face/face").RemoveAPI(UsdShade.MaterialBindingAPI)
    assert complaints(stage)


def test_meshes_and_rig_are_written_as_usdz(tmp_path, monkeypatch):
    from pxr import Usd

    monkeypatch.setattr(gazenerf.export.appearance.colours, "PICTURE", 96)
    options = MeshOptions(resolution=40, threshold=100.0, formats=("usdz",), texture=1024, rig=True)
    mesh_subject(AnalyticHead(bind), tmp_path, options)
    for name in ("face", "eyes", "rig"):
        stage = Usd.Stage.Open(str(tmp_path / f"{name}.usdz"))
        assert stage.GetDefaultPrim().IsValid()
    assert stage.GetPrimAtPath("/head/eye_right/eye_right").IsValid()


def test_without_usd_core_the_fix_is_named_before_anything_is_done(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "pxr", None)
    with pytest.raises(UserError, match="gazenerf\\[usd\\]"):
        mesh_subject(AnalyticHead(bind), tmp_path / "out", MeshOptions(formats=("usdz",)))
    assert not (tmp_path / "out").exists()
