"""Levels of detail of models that outgrow a memory: built once, drawn from disk."""
