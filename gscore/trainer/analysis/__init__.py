"""Analysis of a capture before its training."""
