"""Depth maps of a capture: prediction, check against SfM points, colors of the cameras."""
