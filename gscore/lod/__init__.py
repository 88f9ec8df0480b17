"""Levels of detail for models larger than memory: built once, rendered from disk."""
