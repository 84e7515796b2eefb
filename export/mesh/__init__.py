"""Triangle meshes: cleaning, repair, rays, spheres."""
