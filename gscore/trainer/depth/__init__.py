"""Depth supervision: decision, targets, added points and loss."""
