"""Blocks of a large capture: cells, photos per block, and the merge of the trained blocks."""
