"""The output folder of a run: who may write there, checkpoints, results."""
