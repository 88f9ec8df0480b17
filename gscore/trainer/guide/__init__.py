"""Meshes that guide a training: surfaces that splats lie on, and what nothing stands before."""
