"""What leaves: meshes, textures, points and volumes of a head, and pictures with their cameras."""

import warnings

from gazenerf.export.formats.datasets import write_dataset
from gazenerf.export.part_mesh import PartMesh, extract_part
from gazenerf.export.pipeline import mesh_subject

__all__ = ["PartMesh", "extract_part", "mesh_subject", "write_dataset"]

if __name__ == "export":
    warnings.warn("`export` is now `gazenerf.export`; the old name goes in 0.3", DeprecationWarning, stacklevel=2)
