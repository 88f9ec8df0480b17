"""Histograms of opacities and sizes: counting, panel icons, handles in 3D views."""
