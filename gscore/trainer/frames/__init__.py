"""The frames of a sequence: how each is trained, which belong together, which are complete."""
