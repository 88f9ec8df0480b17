"""Depth maps made, aligned and told of, for `gscore depth`."""
