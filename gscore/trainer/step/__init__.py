"""The parts of a training step that need no state of the trainer."""
