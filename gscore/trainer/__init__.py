"""Training: from a capture and options to splats, with checkpoints, events and control."""
