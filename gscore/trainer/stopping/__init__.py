"""Length of a run: time budget, stopping criteria, watchdog for divergence."""
