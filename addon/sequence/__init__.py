"""Training jobs for sequences, frame by frame."""
