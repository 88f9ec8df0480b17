"""Measured trainings, paired statistics and synthetic captures of the benchmarks."""
