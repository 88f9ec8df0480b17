"""Host process of a training: memory allocation, random numbers, torch settings, timers."""
