"""Parts of a training step without state of the trainer: views, loss, result."""
