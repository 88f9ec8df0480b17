"""Benchmarks that a user can repeat: speed, memory, run time against error, held-out quality."""
