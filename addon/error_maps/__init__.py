"""Error maps of a result: errors of photos on cameras and of pixels on splats."""
