"""From a head to a folder of meshes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from gazenerf.errors import UserError
from gazenerf.export.appearance.textured_views import texture_psnr
from gazenerf.export.formats.files import (
    Facts,
    WrittenPart,
    common_facts,
    part_files,
    textured_node,
    write_part,
    write_sidecar,
)
from gazenerf.export.formats.gltf import glb
from gazenerf.export.formats.page import rig_page
from gazenerf.export.formats.usd import check_usd, usdz
from gazenerf.export.mesh.face_distance import distance_in_face_crop
from gazenerf.export.options import TEXTURED, MeshOptions
from gazenerf.export.part_mesh import PartMesh, extract_part
from gazenerf.export.scenes.lids import with_lids
from gazenerf.export.scenes.rig import Scene, rig
from gazenerf.export.scenes.sequence import check_sequence, sequence_scene
from gazenerf.files import refuse_existing, whole_folder
from gazenerf.geometry import Gaze
from gazenerf.head_model import ReferenceHead
from gazenerf.heads.highlights import without_highlights
from gazenerf.heads.interface import BoundField, HeadField, Part
from gazenerf.progress import Progress, silent

PAGE_LINE = (
    "A head taken out of a neural field (GazeNeRF) as a textured mesh: the eyeballs turn about their centres, and the "
    "lids follow the gaze."
)
"""What index.html says of itself."""


@dataclass(frozen=True)
class WrittenScene:
    """A scene that was written.

    Attributes:
        files: Kind to file.
        facts: What its sidecar says.
    """

    files: dict[str, Path]
    facts: Facts


@dataclass(frozen=True)
class MeshReport:
    """What was written and measured.

    Attributes:
        out: Folder.
        parts: Part to what was written of it.
        scenes: `rig` and `sequence`, those that were made.
        numbered: Folders of a sequence's gazes, where the parts were written at each.
    """

    out: Path
    parts: dict[Part, WrittenPart]
    scenes: dict[str, WrittenScene] = field(default_factory=dict)
    numbered: tuple[Path, ...] = ()


def mesh_subject(
    head: HeadField,
    out: str | Path,
    options: MeshOptions | None = None,
    *,
    gaze: Gaze | None = None,
    sequence: Sequence[Gaze] = (),
    numbered: bool = False,
    overwrite: bool = False,
    progress: Progress = silent,
) -> MeshReport:
    """Extract parts of a head and write them to a folder: `PART.FORMAT` and one `PART.json` each.

    Files are in metres, Y up, face toward +Z. Nothing is written unless everything succeeds.

    Args:
        head: Who is meshed.
        out: Folder.
        options: How, and what is written; `MeshOptions()` by default.
        gaze: Of the meshes, head frame; straight ahead by default.
        sequence: Gazes of `sequence.glb`, whose eyes turn and whose face follows; the rig is written with it.
        numbered: Write the parts at every gaze of the sequence instead, into `sequence/0000` and so on.
        overwrite: Replace files of these names.
        progress: Told about stages.

    Raises:
        UserError: impossible settings, an empty volume, no surface, or existing files without `overwrite`.
    """
    out, options, gaze = Path(out), options or MeshOptions(), gaze or Gaze()
    rigged = options.rig or options.page or bool(len(sequence))
    _check(options, rigged, sequence)
    if not rigged and not set(TEXTURED) & set(options.formats):
        options = replace(options, texture=None)
    refuse_existing([out / name for name in _names(options, rigged, len(sequence), numbered)], overwrite)
    head = without_highlights(head)
    bound = head.at(gaze)
    meshes: dict[Part, PartMesh] = {
        part: extract_part(bound, part, options, progress=progress) for part in options.parts
    }
    measured = {part: _measured(bound, extracted, progress) for part, extracted in meshes.items()}
    scenes = _scenes(head, bound, meshes, options, () if numbered else sequence, progress) if rigged else {}
    parts: dict[Part, WrittenPart] = {}
    written: dict[str, WrittenScene] = {}
    with whole_folder(out) as folder:
        for part, extracted in meshes.items():
            facts = write_part(extracted, bound, folder, options, measured[part])
            files = {kind: out / name for kind, name in part_files(part, options).items()}
            parts[part] = WrittenPart(extracted, files, facts)
        for name, scene in scenes.items():
            facts, files = _write_scene(name, scene, bound, folder, options)
            written[name] = WrittenScene({kind: out / file for kind, file in files.items()}, facts)
        if numbered:
            _write_numbered(head, meshes, sequence, folder, options, progress)
    places = tuple(out / _numbered(i) for i in range(len(sequence))) if numbered else ()
    return MeshReport(out, parts, written, places)


def _check(options: MeshOptions, rigged: bool, sequence: Sequence[Gaze]) -> None:
    """Raise UserError for what cannot be made."""
    options.check()
    if "usdz" in options.formats:
        check_usd()
    if rigged and not {"face", "eyes"} <= set(options.parts):
        raise UserError("the rig needs --parts face eyes")
    if len(sequence):
        check_sequence(sequence)


def _names(options: MeshOptions, rigged: bool, gazes: int, numbered: bool) -> list[str]:
    """Every file that will be written."""
    files = [name for part in options.parts for name in part_files(part, options).values()]
    names = list(files)
    if rigged:
        names += ["rig.glb", "rig.json", *(["rig.usdz"] if "usdz" in options.formats else [])]
        names += ["index.html"] if options.page else []
    if gazes and not numbered:
        names += ["sequence.glb", "sequence.json"]
    if numbered:
        names += [f"{_numbered(i)}/{name}" for i in range(gazes) for name in files]
    return names


def _numbered(i: int) -> str:
    return f"sequence/{i:04d}"


def _measured(bound: BoundField, extracted: PartMesh, progress: Progress) -> Facts:
    """What a mesh is compared with, for the sidecar: the head model, and the field's own pictures."""
    facts: Facts = {}
    reference = ReferenceHead.of(bound.subject)
    if reference is not None and extracted.part != "eyes":
        away = distance_in_face_crop(extracted.mesh, reference.at(bound.gaze))
        mm = away * 1000.0 * bound.metres_per_unit
        facts["median_mm_from_the_head_model_in_the_face_crop"] = None if np.isnan(mm) else mm
    if extracted.textured is not None:
        progress(f"{extracted.part} texture against the field", 0, 1)
        data = glb(textured_node(extracted.part, extracted.textured, bound.metres_per_unit))
        facts["texture_against_the_field"] = texture_psnr(bound, extracted.part, data)
    return facts


def _scenes(
    head: HeadField,
    bound: BoundField,
    meshes: dict[Part, PartMesh],
    options: MeshOptions,
    sequence: Sequence[Gaze],
    progress: Progress,
) -> dict[str, Scene]:
    """The rig and, where gazes are given, the sequence, by the names of their files."""
    progress("rig", 0, 1)
    face, eyes = meshes["face"], meshes["eyes"]
    texture = None
    if face.textured is not None:
        texture = textured_node("face", face.textured, bound.metres_per_unit).texture
    surface = face.mesh if face.textured is None else face.textured.mesh
    plain = rig(head, bound.gaze, surface, eyes.mesh, texture)
    scenes = {"rig": plain}
    if face.threshold is not None and bound.gaze == Gaze():
        scenes["rig"] = with_lids(head, plain, surface, face.threshold.level, progress)
    if not options.clip:
        scenes["rig"] = replace(scenes["rig"], clips=())
    if len(sequence):
        if face.threshold is None:
            raise UserError("a sequence follows a density; it needs --surface isosurface, or --sequence-files")
        level = face.threshold.level
        scenes["sequence"] = sequence_scene(head, bound.gaze, plain, sequence, surface, level, progress)
    return scenes


def _write_scene(
    name: str, scene: Scene, bound: BoundField, folder: Path, options: MeshOptions
) -> tuple[Facts, dict[str, str]]:
    """Write a scene and its sidecar; what that says, and kind to file name."""
    files = {"glb": f"{name}.glb"}
    (folder / files["glb"]).write_bytes(glb(scene.root, scene.clips, compressed=options.compress))
    if name == "rig" and options.page:
        files["html"] = "index.html"
        data = glb(scene.root, scene.clips, compressed=True)
        page = rig_page(data, bound.subject.name, PAGE_LINE)
        (folder / files["html"]).write_text(page, encoding="utf-8")
    if name == "rig" and "usdz" in options.formats:
        files["usdz"] = "rig.usdz"
        (folder / files["usdz"]).write_bytes(usdz(scene.root, scene.clips))
    facts = common_facts(bound) | {"part": name} | scene.facts
    files["json"] = f"{name}.json"
    write_sidecar(folder / files["json"], facts)
    return facts, files


def _write_numbered(
    head: HeadField,
    meshes: dict[Part, PartMesh],
    sequence: Sequence[Gaze],
    folder: Path,
    options: MeshOptions,
    progress: Progress,
) -> None:
    """The parts at every gaze of a sequence, at the thresholds of the first ones."""
    levels = {part: found.threshold.level for part, found in meshes.items() if found.threshold is not None}
    for i, gaze in enumerate(sequence):
        progress("gazes", i, len(sequence))
        (folder / _numbered(i)).mkdir(parents=True)
        turned = head.at(gaze)
        for part in options.parts:
            at_level = replace(options, threshold=levels.get(part, "auto"))
            found = extract_part(turned, part, at_level, progress=progress)
            write_part(found, turned, folder / _numbered(i), options)
