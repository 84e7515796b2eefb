"""What leaves: meshes, textures, points and volumes of a head, and pictures with their cameras."""

from __future__ import annotations

import importlib
import warnings
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gazenerf.export.formats.datasets import write_dataset
    from gazenerf.export.options import MeshOptions
    from gazenerf.export.part_mesh import PartMesh, extract_part
    from gazenerf.export.pipeline import MeshReport, mesh_subject

__all__ = ["MeshOptions", "MeshReport", "PartMesh", "extract_part", "mesh_subject", "write_dataset"]

_HOMES = {
    "MeshOptions": "options",
    "MeshReport": "pipeline",
    "PartMesh": "part_mesh",
    "extract_part": "part_mesh",
    "mesh_subject": "pipeline",
    "write_dataset": "formats.datasets",
}
"""Name to the module that defines it; modules are loaded when a name is first used."""


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'gazenerf.export' has no attribute {name!r}")
    return getattr(importlib.import_module(f"gazenerf.export.{_HOMES[name]}"), name)


if __name__ == "export":
    warnings.warn("`export` is now `gazenerf.export`; the old name goes in 0.3", DeprecationWarning, stacklevel=2)
