"""PLY files: every dialect of splats in, the official 3DGS layout out; points."""
