"""Files of a run: output folder, checkpoints, results."""
