"""Forecast of time and memory of a training, without torch; the automatic device."""
