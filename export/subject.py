"""From a bound field to a folder of files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from export.files import FORMATS, common_facts, part_files, textured_node, write_part, write_sidecar
from export.gltf import glb
from export.meshes import PartMesh, extract_part
from export.rig import rig
from export.textured_views import texture_psnr
from export.volumes import check_volume
from gazenerf.errors import UserError
from gazenerf.field.interface import BoundField, Part
from gazenerf.files import whole_folder
from gazenerf.geometry import Gaze


def mesh_subject(
    bound: BoundField,
    out: str | Path,
    *,
    parts: tuple[Part, ...] = ("face", "eyes"),
    resolution: int = 192,
    threshold: str | float = "auto",
    formats: tuple[str, ...] = ("glb", "ply", "obj"),
    colours: bool = True,
    method: str = "flying-edges",
    surface: str = "isosurface",
    smoothing: int = 0,
    max_faces: int | None = None,
    texture: int | None = None,
    points: int | None = None,
    volumes: tuple[str, ...] = (),
    bind: Callable[[Gaze], BoundField] | None = None,
    overwrite: bool = False,
    progress: Callable[[str, int, int], None] | None = None,
) -> dict[str, PartMesh]:
    """Extract parts and write them to a folder: `PART.FORMAT` and one `PART.json` each.

    Files are in metres, Y up, face toward +Z. Nothing is written unless everything succeeds.

    Args:
        bound: What is meshed.
        out: Folder.
        parts: Some of face, eyes, head.
        formats: Some of glb, ply, obj, stl; stl is in millimetres. glb, obj and the rig carry the
            texture, which is not made where none of them is written.
        volumes: Some of nrrd, vti, npz: `PART.nrrd` and so on hold the density of every grid point.
        points: Write `PART-points.ply` with so many points.
        bind: Binds the same subject to other gazes; given, `rig.glb` with turning eyes is written too.
        overwrite: Replace files of these names.
        resolution, threshold, colours, method, surface, smoothing, max_faces, texture, progress: See
            `extract_part`.

    Returns:
        Part to its mesh, in world units.

    Raises:
        UserError: see `extract_part`; also unknown formats and existing files without `overwrite`.
    """
    if unknown := sorted(set(formats) - set(FORMATS)):
        raise UserError(f"unknown format {unknown[0]!r}; there are {', '.join(FORMATS)}")
    for kind in volumes:
        check_volume(kind)
    if not parts or not formats:
        raise UserError("give at least one part and one format")
    out = Path(out)
    if bind is not None and not {"face", "eyes"} <= set(parts):
        raise UserError("the rig needs --parts face eyes")
    if bind is None and not {"glb", "obj"} & set(formats):
        texture = None
    names = [
        name
        for part in parts
        for name in part_files(
            part, formats, texture=texture is not None, points=points is not None, volumes=volumes
        ).values()
    ]
    names += ["rig.glb", "rig.json"] if bind is not None else []
    taken = [out / name for name in names if (out / name).exists()]
    if taken and not overwrite:
        raise UserError(f"{taken[0]} exists; add --overwrite or choose another --out")
    meshes = {
        part: extract_part(
            bound,
            part,
            resolution=resolution,
            threshold=threshold,
            method=method,
            surface=surface,
            smoothing=smoothing,
            max_faces=max_faces,
            colours=colours,
            texture=texture,
            points=points,
            volume=bool(volumes),
            progress=progress,
        )
        for part in parts
    }
    tell = progress or (lambda stage, done, total: None)
    facts = {part: _rendered_back(bound, extracted, tell) for part, extracted in meshes.items()}
    rigged = None
    if bind is not None:
        tell("rig", 0, 1)
        rigged = _rig(bind, bound, meshes["face"], meshes["eyes"])
    with whole_folder(out) as folder:
        for part, extracted in meshes.items():
            write_part(extracted, bound, folder, formats, volumes, facts[part])
        if rigged is not None:
            (folder / "rig.glb").write_bytes(rigged[0])
            write_sidecar(folder / "rig.json", common_facts(bound) | {"part": "rig"} | rigged[1])
    return dict(meshes)


def _rendered_back(bound: BoundField, extracted: PartMesh, tell: Callable[[str, int, int], None]) -> dict[str, Any]:
    """How well a texture shows what the field shows, for the sidecar."""
    if extracted.textured is None:
        return {}
    tell(f"{extracted.part} texture against the field", 0, 1)
    data = glb(textured_node(extracted.part, extracted.textured, bound.metres_per_unit))
    return {"texture_against_the_field": texture_psnr(bound, extracted.part, data)}


def _rig(
    bind: Callable[[Gaze], BoundField], bound: BoundField, face: PartMesh, eyes: PartMesh
) -> tuple[bytes, dict[str, Any]]:
    if face.textured is None:
        return rig(bind, bound.gaze, face.mesh, eyes.mesh)
    texture = textured_node("face", face.textured, bound.metres_per_unit).texture
    return rig(bind, bound.gaze, face.textured.mesh, eyes.mesh, texture)
