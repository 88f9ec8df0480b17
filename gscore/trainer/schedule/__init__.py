"""Schedule of a run: learning rates, refinement steps, photo sizes, caps, options that an engine
lacks."""
