"""Triangle meshes: reads PLY and OBJ files, writes PLY."""
