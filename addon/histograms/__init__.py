"""Histograms of splats: counted, shown in a panel, and with handles in 3D views."""
