"""Where a result is wrong: errors of photos on cameras, and of pixels on splats."""
