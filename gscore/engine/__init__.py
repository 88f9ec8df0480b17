"""Engines: rendering, gradients and optimizer steps of a training, on one kind of device."""
