"""Captures in the scene: cameras with photos, SfM points, alignment, import and export."""
