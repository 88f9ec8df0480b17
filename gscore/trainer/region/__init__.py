"""Region training: a box is trained again among frozen splats."""
