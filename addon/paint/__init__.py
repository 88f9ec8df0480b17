"""Splats painted with a brush: colours, opacities, selections."""
