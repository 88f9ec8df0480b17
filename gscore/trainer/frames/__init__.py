"""Frames of a sequence: plan, dependencies and results."""
