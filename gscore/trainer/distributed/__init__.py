"""Distributed training on several processes: communication, consistency, gradient sums."""
