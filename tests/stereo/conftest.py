"""A capture whose depth is known."""

from .captures import arc  # noqa: F401
