"""Guide meshes: surfaces that splats lie on, and free space in front of meshes."""
