"""A capture with known depth."""

from .captures import arc  # noqa: F401
