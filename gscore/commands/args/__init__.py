"""What verbs are given: options, the names that 3DGS has for them, models."""
