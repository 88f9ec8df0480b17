"""Splats as Blender objects."""
