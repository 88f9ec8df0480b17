"""A capture as Blender objects: cameras with their photos, and points."""
