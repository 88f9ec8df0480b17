"""Viewers: the drawing rules of other programs, their pictures, and splats fitted to them."""
