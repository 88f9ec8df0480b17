"""When things happen in a run of so many steps, and at which rates."""
