"""Rendering splats in Blender: the engine, comparison with photos, compositing with meshes."""
