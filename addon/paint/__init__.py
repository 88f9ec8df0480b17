"""Brush for splats: colours, opacities, selections, copies."""
