"""Depth maps of a capture: predicted, compared, and shown on its cameras."""
