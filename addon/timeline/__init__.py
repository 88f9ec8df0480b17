"""Splat sequences on the timeline."""
