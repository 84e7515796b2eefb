"""The field's surface and the reference, each coloured by its distance from the other, as one GLB."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gazenerf.export.formats.files import common_facts, in_metres
from gazenerf.export.formats.gltf import glb
from gazenerf.export.formats.nodes import Node
from gazenerf.export.surface.density_surface import density_surface
from gazenerf.export.surface.isosurface import METHODS
from gazenerf.head_model import HeadMesh
from gazenerf.heads.interface import BoundField
from gazenerf.progress import Progress, silent
from gazenerf.viz.pictures.surface_colours import GIVE_UP_MM, LIMIT_MM, coloured_by_distance, outward_mm

if TYPE_CHECKING:
    import trimesh

FILE = "error.glb"
RESOLUTION = 128
"""Grid points along the longest side of the field's surface."""

BESIDE_M = 0.3
"""Metres by which the reference stands to the subject's left of the field in the file."""


@dataclass(frozen=True)
class ErrorMesh:
    """Two coloured surfaces in world units, one over the other.

    Attributes:
        field, reference: With vertex colours: white where both agree, blue where the field stands out of the reference,
            red where it lies too deep, grey where there is nothing to compare with.
        field_mm, reference_mm: (V,) signed distances, millimetres, positive where the field stands out; NaN where grey.
        threshold: Density of the field's surface.
    """

    field: trimesh.Trimesh
    reference: trimesh.Trimesh
    field_mm: np.ndarray
    reference_mm: np.ndarray
    threshold: float

    def facts(self) -> dict[str, Any]:
        """Plain numbers for a sidecar and the report."""

        def share(values: np.ndarray) -> dict[str, float | int | None]:
            known = values[np.isfinite(values)]
            near = {f"{q}_percentile_mm": float(np.percentile(known, q)) if known.size else None for q in (5, 50, 95)}
            return {"vertices": len(values), "compared": int(known.size), **near}

        return {
            "colours": f"blue to red: field {LIMIT_MM:g} mm outside the reference to {LIMIT_MM:g} mm inside",
            "limit_mm": LIMIT_MM,
            "grey_beyond_mm": GIVE_UP_MM,
            "reference_moved_m": [BESIDE_M, 0.0, 0.0],
            "density_threshold": self.threshold,
            "field": share(self.field_mm),
            "reference": share(self.reference_mm),
        }


def error_mesh(
    bound: BoundField,
    mesh: HeadMesh,
    *,
    resolution: int = RESOLUTION,
    threshold: str | float = "auto",
    progress: Progress = silent,
) -> ErrorMesh:
    """Colour the field's surface and the reference by their distance from each other.

    Args:
        bound: The field.
        mesh: The reference at the same gaze.
        resolution, threshold: Of the field's surface, see `density_surface`.
        progress: Told how far the sampling of the density is.

    Raises:
        UserError: the field has no surface.
    """
    import trimesh

    surface = density_surface(
        bound, "head", resolution=resolution, threshold=threshold, method=METHODS[0], progress=progress
    )
    field = surface.mesh
    reference = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    out = outward_mm(np.asarray(field.vertices), reference, bound.metres_per_unit)
    back = -outward_mm(np.asarray(reference.vertices), field, bound.metres_per_unit)
    level = surface.threshold.level if surface.threshold else float("nan")
    return ErrorMesh(coloured_by_distance(field, out), coloured_by_distance(reference, back), out, back, level)


def write_error_mesh(error: ErrorMesh, bound: BoundField, folder: Path) -> dict[str, Any]:
    """Write `error.glb` (metres, Y up) to a folder and return the facts for report.json."""
    scale = bound.metres_per_unit
    nodes = Node(
        "error",
        children=(
            Node("field", in_metres(error.field, scale)),
            Node("reference", in_metres(error.reference, scale), translation=(BESIDE_M, 0.0, 0.0)),
        ),
    )
    (folder / FILE).write_bytes(glb(nodes))
    return {"file": FILE, **error.facts(), **{k: v for k, v in common_facts(bound).items() if k in ("units", "frame")}}
