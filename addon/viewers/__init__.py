"""Splats fitted to how Blender draws them, by the trainer's Python."""
