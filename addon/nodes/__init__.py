"""Geometry and shader nodes built in Python: filters, colours, materials, display."""
