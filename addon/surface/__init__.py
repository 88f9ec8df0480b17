"""Surface of a result: meshes made by the trainer's Python, imported with colors."""
