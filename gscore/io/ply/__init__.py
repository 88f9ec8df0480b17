"""PLY files: reads every dialect of splats and point clouds, writes the official 3DGS layout."""
