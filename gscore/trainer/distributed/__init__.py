"""One training on many processes: how they speak, what they agree on, how gradients are summed."""
