"""The process that a training runs in: its memory, random numbers, settings of torch, and clock."""
