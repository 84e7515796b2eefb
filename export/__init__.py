"""What leaves: meshes, textures, points and volumes of a head, and pictures with their cameras."""

from export.datasets import write_dataset
from export.meshes import PartMesh, extract_part
from export.subject import mesh_subject

__all__ = ["PartMesh", "extract_part", "mesh_subject", "write_dataset"]
