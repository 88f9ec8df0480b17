"""Depth maps of a capture: prediction, comparison, display on the cameras."""
