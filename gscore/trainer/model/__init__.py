"""Model in training: parameters, Adam moments, initial splats, sanitizing, checkpoint schema."""
