"""Sequences of splats on Blender's timeline."""
