"""Splats drawn by the graphics card in every 3D view: sorted, blended, with full colour."""
