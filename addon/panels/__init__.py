"""Panels of the sidebar tab "Train Splats"."""
