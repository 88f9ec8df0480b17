"""COLMAP reconstructions: binary and text files, read and written with numpy only."""
