"""From a bound field to a folder of files."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from gazenerf.errors import UserError
from gazenerf.export.appearance.textured_views import texture_psnr
from gazenerf.export.formats.files import (
    FORMATS,
    TEXTURED,
    common_facts,
    part_files,
    textured_node,
    write_part,
    write_sidecar,
)
from gazenerf.export.formats.gltf import glb
from gazenerf.export.formats.usd import check_usd, usdz
from gazenerf.export.formats.volumes import check_volume
from gazenerf.export.mesh.face_distance import distance_in_face_crop, reference_mesh
from gazenerf.export.part_mesh import PartMesh, extract_part
from gazenerf.export.scenes.rig import Scene, rig
from gazenerf.export.scenes.sequence import check_sequence, sequence_scene
from gazenerf.files import whole_folder
from gazenerf.geometry import Gaze
from gazenerf.heads.interface import BoundField, Part

Bind = Callable[[Gaze], BoundField]
Tell = Callable[[str, int, int], None]


def mesh_subject(
    bound: BoundField,
    out: str | Path,
    *,
    parts: tuple[Part, ...] = ("face", "eyes"),
    formats: tuple[str, ...] = ("glb", "ply", "obj"),
    volumes: tuple[str, ...] = (),
    bind: Bind | None = None,
    sequence: Sequence[Gaze] = (),
    numbered: bool = False,
    overwrite: bool = False,
    progress: Tell | None = None,
    **settings: Any,
) -> dict[str, PartMesh]:
    """Extract parts and write them to a folder: `PART.FORMAT` and one `PART.json` each.

    Files are in metres, Y up, face toward +Z. Nothing is written unless everything succeeds.

    Args:
        bound: What is meshed.
        out: Folder.
        parts: Some of face, eyes, head.
        formats: Some of glb, ply, obj, stl, usdz; stl is in millimetres. glb, obj, usdz and the rig carry
            the texture, which is not made where none of them is written.
        volumes: Some of nrrd, vti, npz: `PART.nrrd` and so on hold the density of every grid point.
        bind: Binds the same subject to other gazes; given, `rig.glb` with turning eyes is written too,
            and `rig.usdz` where usdz is among the formats.
        sequence: Gazes of `sequence.glb`, whose eyes turn and whose face follows; needs `bind`.
        numbered: Write the parts at every gaze of the sequence instead, into `sequence/0000` and so on.
        overwrite: Replace files of these names.
        settings: What `extract_part` takes: resolution, threshold, surface, smoothing, colours, texture,
            points and so on.

    Returns:
        Part to its mesh, in world units.

    Raises:
        UserError: see `extract_part`; also unknown formats and existing files without `overwrite`.
    """
    out = Path(out)
    _check(parts, formats, volumes, bind, sequence)
    if bind is None and not set(TEXTURED) & set(formats):
        settings["texture"] = None
    files = [
        name
        for part in parts
        for name in part_files(
            part,
            formats,
            texture=settings.get("texture") is not None,
            points=settings.get("points") is not None,
            volumes=volumes,
        ).values()
    ]
    names = list(files)
    if bind is not None:
        names += ["rig.glb", "rig.json", *(["rig.usdz"] if "usdz" in formats else [])]
    if sequence and not numbered:
        names += ["sequence.glb", "sequence.json"]
    if numbered:
        names += [f"{_numbered(i)}/{name}" for i in range(len(sequence)) for name in files]
    taken = [out / name for name in names if (out / name).exists()]
    if taken and not overwrite:
        raise UserError(f"{taken[0]} exists; add --overwrite or choose another --out")
    extract = partial(extract_part, **settings, volume=bool(volumes), progress=progress)
    meshes: dict[Part, PartMesh] = {part: extract(bound, part) for part in parts}
    tell = progress or (lambda stage, done, total: None)
    facts = {part: _measured(bound, extracted, tell) for part, extracted in meshes.items()}
    scenes = {} if bind is None else _scenes(bind, bound, meshes, () if numbered else sequence, tell)
    with whole_folder(out) as folder:
        for part, extracted in meshes.items():
            write_part(extracted, bound, folder, formats, volumes, facts[part])
        for name, scene in scenes.items():
            (folder / f"{name}.glb").write_bytes(glb(scene.root, scene.clips))
            if name == "rig" and "usdz" in formats:
                (folder / "rig.usdz").write_bytes(usdz(scene.root, scene.clips))
            write_sidecar(folder / f"{name}.json", common_facts(bound) | {"part": name} | scene.facts)
        if numbered and bind is not None:
            levels = {part: found.threshold.level for part, found in meshes.items() if found.threshold is not None}
            for i, gaze in enumerate(sequence):
                tell("gazes", i, len(sequence))
                (folder / _numbered(i)).mkdir(parents=True)
                turned = bind(gaze)
                for part in parts:
                    found = extract(turned, part, threshold=levels.get(part, "auto"))
                    write_part(found, turned, folder / _numbered(i), formats, volumes)
    return dict(meshes.items())


def _numbered(i: int) -> str:
    return f"sequence/{i:04d}"


def _check(
    parts: Sequence[str],
    formats: Sequence[str],
    volumes: Sequence[str],
    bind: Bind | None,
    sequence: Sequence[Gaze],
) -> None:
    """Raise UserError for what cannot be made."""
    if unknown := sorted(set(formats) - set(FORMATS)):
        raise UserError(f"unknown format {unknown[0]!r}; there are {', '.join(FORMATS)}")
    for kind in volumes:
        check_volume(kind)
    if "usdz" in formats:
        check_usd()
    if not parts or not formats:
        raise UserError("give at least one part and one format")
    if bind is not None and not {"face", "eyes"} <= set(parts):
        raise UserError("the rig needs --parts face eyes")
    if len(sequence):
        if bind is None:
            raise ValueError("a sequence needs `bind`")
        check_sequence(sequence)


def _measured(bound: BoundField, extracted: PartMesh, tell: Tell) -> dict[str, Any]:
    """What a mesh is compared with, for the sidecar: the head model, and the field's own pictures."""
    facts: dict[str, Any] = {}
    reference = reference_mesh(bound)
    if reference is not None and extracted.part != "eyes":
        away = distance_in_face_crop(extracted.mesh, reference)
        mm = away * 1000.0 * bound.metres_per_unit
        facts["median_mm_from_the_head_model_in_the_face_crop"] = None if np.isnan(mm) else mm
    if extracted.textured is not None:
        tell(f"{extracted.part} texture against the field", 0, 1)
        data = glb(textured_node(extracted.part, extracted.textured, bound.metres_per_unit))
        facts["texture_against_the_field"] = texture_psnr(bound, extracted.part, data)
    return facts


def _scenes(
    bind: Bind, bound: BoundField, meshes: Mapping[Part, PartMesh], sequence: Sequence[Gaze], tell: Tell
) -> dict[str, Scene]:
    """The rig and, where gazes are given, the sequence, by the names of their files."""
    tell("rig", 0, 1)
    face, eyes = meshes["face"], meshes["eyes"]
    texture = None
    if face.textured is not None:
        texture = textured_node("face", face.textured, bound.metres_per_unit).texture
    surface = face.mesh if face.textured is None else face.textured.mesh
    scenes = {"rig": rig(bind, bound.gaze, surface, eyes.mesh, texture)}
    if len(sequence):
        if face.threshold is None:
            raise UserError("a sequence follows a density; it needs --surface isosurface, or --sequence-files")
        level = face.threshold.level
        told = lambda done, total: tell("sequence", done, total)  # noqa: E731
        scenes["sequence"] = sequence_scene(bind, bound.gaze, scenes["rig"], sequence, surface, level, told)
    return scenes
