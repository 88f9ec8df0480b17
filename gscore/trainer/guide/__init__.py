"""Guide meshes: surfaces for the depth loss, and free space in front of meshes."""
