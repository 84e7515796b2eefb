"""What leaves: densities, isosurfaces, meshes, files."""

from export.meshes import PartMesh, extract_part, mesh_subject

__all__ = ["PartMesh", "extract_part", "mesh_subject"]
