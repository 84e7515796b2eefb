"""Faults of known size put on a field that was trained, and how much of each `gazenerf check` reads.

`python -m gazenerf.viz.selftest.field_faults` prints the table of docs/consistency.md. The matrix of `faults` is of an
exact scene; a trained field has errors of its own, and here is told whether faults are read at their size beside them.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from gazenerf.geometry import Gaze
from gazenerf.geometry.gaze import rotation_y
from gazenerf.geometry.paths import GazeRange
from gazenerf.head_model import HeadMesh, ReferenceHead
from gazenerf.head_model.interface import EYE_LEFT
from gazenerf.heads import HeadField
from gazenerf.heads.highlights import without_highlights
from gazenerf.heads.interface import BoundField
from gazenerf.loading import load
from gazenerf.viz.check.field import check_subject
from gazenerf.viz.check.options import GAZES, CheckOptions
from gazenerf.viz.selftest.exact_scene import moved_mesh

VIEWS, SIZE = 7, 192


@dataclass(frozen=True)
class ChangedReference:
    """The head model fitted to a subject, with its surface changed; see `gazenerf.viz.metrics.reference.Reference`.

    Attributes:
        true: The fitted head model.
        change: Mesh to the one that it is given out for.
    """

    true: ReferenceHead
    change: Callable[[HeadMesh], HeadMesh]

    @property
    def illumination(self) -> np.ndarray:
        """(27,) the subject's."""
        return self.true.illumination

    def at(self, gaze: Gaze) -> HeadMesh:
        """The changed mesh at a gaze (head frame)."""
        return self.change(self.true.at(gaze))


class MisledHead:
    """A head whose eyes look elsewhere than they are told; see `gazenerf.heads.interface.HeadField`.

    Args:
        head: That turns its eyes.
        looks: Gaze that is asked for to the one that it gets.
    """

    def __init__(self, head: HeadField, looks: Callable[[Gaze], Gaze]) -> None:
        self.head, self.looks, self.subject = head, looks, head.subject

    @property
    def device(self) -> torch.device:
        """See `HeadField`."""
        return self.head.device

    @property
    def trained_range(self) -> GazeRange | None:
        """See `HeadField`."""
        return self.head.trained_range

    def at(self, gaze: Gaze) -> BoundField:
        """The head at the gaze that it takes this one for."""
        return self.head.at(self.looks(gaze))


@dataclass(frozen=True)
class FieldFault:
    """A fault, and what is to be read of it.

    Attributes:
        metric: Which reads it.
        size: By how much, in the metric's unit.
        mesh: Reference head to the one that is compared with.
        looks: Gaze that is asked for to the one that the field gets.
        swept: Whether the metric needs all gazes.
    """

    metric: str
    size: float
    mesh: Callable[[HeadMesh], HeadMesh] = lambda mesh: mesh
    looks: Callable[[Gaze], Gaze] = lambda gaze: gaze
    swept: bool = False


def turned_mesh(mesh: HeadMesh, degrees: float) -> HeadMesh:
    """A reference turned about the vertical axis towards the subject's left."""
    turn = rotation_y(float(np.deg2rad(degrees)))
    return replace(
        mesh,
        vertices=(mesh.vertices @ turn.T).astype(np.float32),
        normals=(mesh.normals @ turn.T).astype(np.float32),
        landmarks={name: turn @ point for name, point in mesh.landmarks.items()},
        eye_centres=mesh.eye_centres @ turn.T,
    )


def moved_eye(mesh: HeadMesh, offset_mm: tuple[float, float, float]) -> HeadMesh:
    """A reference whose left eyeball lies elsewhere."""
    offset = np.asarray(offset_mm) / (1000.0 * mesh.metres_per_unit)
    vertices, centres = mesh.vertices.copy(), np.array(mesh.eye_centres)
    vertices[np.unique(mesh.part_faces(EYE_LEFT))] += offset.astype(np.float32)
    centres[0] += offset
    landmarks = {**mesh.landmarks, "iris_left": mesh.landmarks["iris_left"] + offset}
    return replace(mesh, vertices=vertices, eye_centres=centres, landmarks=landmarks)


FIELD_FAULTS: dict[str, FieldFault] = {
    "reference moved 2.0 mm to the left": FieldFault(
        "frame_shift_mm", 2.0, mesh=lambda mesh: moved_mesh(mesh, offset_mm=(2.0, 0.0, 0.0))
    ),
    "reference moved 2.0 mm forward": FieldFault(
        "frame_shift_mm", 2.0, mesh=lambda mesh: moved_mesh(mesh, offset_mm=(0.0, 0.0, 2.0))
    ),
    "reference 2 % larger": FieldFault("scale_percent", 2.0, mesh=lambda mesh: moved_mesh(mesh, scale=1.02)),
    "reference turned by 1.0 degree": FieldFault("frame_turn_deg", 1.0, mesh=lambda mesh: turned_mesh(mesh, 1.0)),
    "left eye of the reference 1.0 mm further out": FieldFault(
        "eye_centre_mm", 1.0, mesh=lambda mesh: moved_eye(mesh, (1.0, 0.0, 0.0))
    ),
    "eyes turned by 3.0 degrees of yaw": FieldFault(
        "gaze_bias_deg", 3.0, looks=lambda gaze: Gaze(gaze.pitch, gaze.yaw + np.deg2rad(3.0)), swept=True
    ),
    "eyes turn by 20 % less than told": FieldFault(
        "gaze_slope", 0.2, looks=lambda gaze: Gaze(0.8 * gaze.pitch, 0.8 * gaze.yaw), swept=True
    ),
    "eyes look up by 10 % of yaw": FieldFault(
        "gaze_crosstalk", 0.1, looks=lambda gaze: Gaze(gaze.pitch + 0.1 * gaze.yaw, gaze.yaw), swept=True
    ),
}
"""Name to what is wrong."""


def read_field(
    head: HeadField, fault: FieldFault | None, metrics: Sequence[str], swept: bool, views: int = VIEWS, size: int = SIZE
) -> dict[str, float]:
    """Metrics of `gazenerf check` of a field with a fault, by name.

    Args:
        head: A subject's head with head-model parameters.
        fault: What is put on it; nothing when None.
        metrics: Their names.
        swept: Look at the eyes over a gaze grid too.
        views: How many.
        size: Of the views, pixels.

    Raises:
        UserError: the subject has no head-model parameters.
    """
    true = ReferenceHead.of(head.subject)
    assert true is not None
    head = without_highlights(head)
    reference = true if fault is None else ChangedReference(true, fault.mesh)
    options = CheckOptions(
        views=views, size=size, gazes=GAZES if swept else 1, reference=("open3d",), orbit=False, error_mesh=False
    )
    result = check_subject(head if fault is None else MisledHead(head, fault.looks), reference, options)
    return {name: result.metric(name).value for name in metrics}


def table(head: HeadField) -> str:
    """What is read of every fault, as Markdown, beside what is read without any."""
    names = list(dict.fromkeys(fault.metric for fault in FIELD_FAULTS.values()))
    without = read_field(head, None, names, swept=True)
    lines = ["| fault | metric | without the fault | with it |", "|---|---|---|---|"]
    for name, fault in FIELD_FAULTS.items():
        found = read_field(head, fault, [fault.metric], fault.swept)[fault.metric]
        lines.append(f"| {name} | `{fault.metric}` | {without[fault.metric]:.3g} | {found:.3g} |")
    return "\n".join(lines)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--subject", default="jana", help="a bundled name or a subject file")
    parser.add_argument("--checkpoint", default="portrait-sdf", help="a bundled field or a file")
    arguments = parser.parse_args()
    print(table(load(arguments.subject, arguments.checkpoint)))


if __name__ == "__main__":
    main()
