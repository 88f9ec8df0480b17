"""Render engine: F12, viewport, comparison with photos, compositing with meshes."""
