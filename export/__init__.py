"""What leaves: meshes, textures, points and volumes of a head, and pictures with their cameras."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING

from gazenerf.lazy import lazy_names

if TYPE_CHECKING:
    from gazenerf.export.formats.datasets import write_dataset
    from gazenerf.export.options import MeshOptions
    from gazenerf.export.part_mesh import PartMesh, extract_part
    from gazenerf.export.pipeline import MeshReport, mesh_subject

__all__ = ["MeshOptions", "MeshReport", "PartMesh", "extract_part", "mesh_subject", "write_dataset"]

__getattr__ = lazy_names(
    "gazenerf.export",
    {
        "MeshOptions": "options",
        "MeshReport": "pipeline",
        "PartMesh": "part_mesh",
        "extract_part": "part_mesh",
        "mesh_subject": "pipeline",
        "write_dataset": "formats.datasets",
    },
)

if __name__ == "export":
    warnings.warn("`export` is now `gazenerf.export`; the old name goes in 0.3", DeprecationWarning, stacklevel=2)
