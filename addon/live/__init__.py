"""Live splats: drawn by the graphics card in every 3D view, sorted and blended."""
