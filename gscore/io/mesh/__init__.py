"""Triangle meshes: PLY and OBJ files in, PLY out."""
