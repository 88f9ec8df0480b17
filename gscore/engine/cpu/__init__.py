"""CPU engine: the native library through torch tensors."""
