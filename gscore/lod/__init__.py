"""Levels of detail for models larger than memory: built once, drawn from disk."""
