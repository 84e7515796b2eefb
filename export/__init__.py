"""What leaves: densities, isosurfaces, meshes, files."""
