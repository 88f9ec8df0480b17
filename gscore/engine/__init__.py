"""Engines: what computes a training; the trainer decides what to train."""
