"""The meshes that lie over the picture: the reference head at once, parts of the field once they are extracted."""

from __future__ import annotations

import threading
import traceback
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import trimesh

from gazenerf.errors import UserError
from gazenerf.export import MeshOptions, extract_part
from gazenerf.geometry import Gaze
from gazenerf.head_model import ReferenceHead
from gazenerf.head_model.interface import NOT_EYES
from gazenerf.heads.interface import HeadField, Part
from gazenerf.progress import Progress
from gazenerf.subjects import Subject
from gazenerf.viz.pictures.surface_colours import outward_mm

RESOLUTION = 96
"""Grid points along the longest side: enough to hold over a picture, and soon there."""


@dataclass(frozen=True)
class OverlayMesh:
    """A mesh in the world's frame and units.

    Attributes:
        vertices: (V, 3) float32.
        faces: (F, 3) int32.
        outward_mm: (V,) how far each vertex stands out of the subject's reference head, millimetres; NaN where they
            are too far apart to be compared, None where there is no reference.
    """

    vertices: np.ndarray
    faces: np.ndarray
    outward_mm: np.ndarray | None = None


def reference_mesh(subject: Subject, gaze: Gaze) -> OverlayMesh | None:
    """The subject's head model at a gaze (head frame); None where the subject carries none."""
    reference = ReferenceHead.of(subject)
    if reference is None:
        return None
    mesh = reference.at(gaze)
    return OverlayMesh(mesh.vertices, mesh.faces)


def part_mesh(head: HeadField, part: Part, gaze: Gaze, progress: Progress) -> OverlayMesh:
    """The surface of one part of a head, uncoloured; all but the eyes' with its distances from the reference head.

    Raises:
        UserError: the part is empty, or the field does not have it.
    """
    options = MeshOptions(parts=(part,), resolution=RESOLUTION, colours=False)
    bound = head.at(gaze)
    mesh = extract_part(bound, part, options, progress=progress).mesh
    reference, outward = ReferenceHead.of(head.subject), None
    if part != "eyes" and reference is not None:
        known = reference.at(gaze)
        faces = known.part_faces(*NOT_EYES) if part == "face" else known.faces
        surface = trimesh.Trimesh(known.vertices, faces, process=False)
        outward = outward_mm(np.asarray(mesh.vertices), surface, bound.metres_per_unit)
    return OverlayMesh(np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.int32), outward)


class Extraction:
    """Extracts parts of a head in a thread of its own, one request at a time; the latest one counts.

    Args:
        done: Given part and mesh, in the thread.
        progress: Told about stages, in the thread.
        failed: Given one line.
    """

    def __init__(
        self, done: Callable[[Part, OverlayMesh], None], progress: Progress, failed: Callable[[str], None]
    ) -> None:
        self._done, self._progress, self._failed = done, progress, failed
        self._condition = threading.Condition()
        self._waiting: tuple[HeadField, Gaze, tuple[Part, ...]] | None = None
        self._closed = False
        self._thread = threading.Thread(target=self._run, name="viewer-meshes", daemon=True)
        self._thread.start()

    def request(self, head: HeadField, gaze: Gaze, parts: tuple[Part, ...] = ("face", "eyes")) -> None:
        """Extract parts of a head at a gaze; what waited before is forgotten."""
        with self._condition:
            self._waiting = head, gaze, parts
            self._condition.notify_all()

    def close(self) -> None:
        """End the thread, after the part that is being extracted."""
        with self._condition:
            self._closed = True
            self._condition.notify_all()
        self._thread.join()

    def _run(self) -> None:
        while (task := self._next()) is not None:
            head, gaze, parts = task
            try:
                for part in parts:
                    mesh = part_mesh(head, part, gaze, self._progress)
                    with self._condition:
                        if self._closed or self._waiting is not None:
                            break
                    self._done(part, mesh)
            except UserError as error:
                self._failed(str(error))
            except Exception as error:  # a mesh that fails must not end the others
                traceback.print_exc()
                self._failed(f"no mesh: {error}")

    def _next(self) -> tuple[HeadField, Gaze, tuple[Part, ...]] | None:
        with self._condition:
            self._condition.wait_for(lambda: self._closed or self._waiting is not None)
            task, self._waiting = self._waiting, None
            return None if self._closed else task
