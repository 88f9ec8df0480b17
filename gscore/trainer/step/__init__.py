"""Parts of a training step: start, models, views, requests, steps in flight, edits, results."""
