"""Forecast of time and memory of a training; no torch."""
