"""Live drawing: splats sorted and blended by the graphics card in every 3D view."""
