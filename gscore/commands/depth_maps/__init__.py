"""Depth maps of `gscore depth`: prediction, alignment and report."""
