"""Depth maps in a training: whether they are used, the targets and points of them, the loss."""
