"""Equality of splats."""

from dataclasses import fields

import numpy as np

from gscore.splats import Splats


def assert_equal_splats(found: Splats, expected: Splats) -> None:
    """All arrays are equal."""
    for item in fields(Splats):
        a, b = getattr(found, item.name), getattr(expected, item.name)
        np.testing.assert_array_equal(a, b, item.name)
