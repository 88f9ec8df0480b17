"""Python environment for training: search, check, installation."""
