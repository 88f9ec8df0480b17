"""Splats as Blender objects: import, display, filters, edits, export."""
