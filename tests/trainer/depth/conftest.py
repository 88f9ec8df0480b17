"""A capture whose depth is known."""

from tests.stereo.captures import arc  # noqa: F401
