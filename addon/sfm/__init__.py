"""Cameras of photos or of a video, found beside Blender and brought in."""
