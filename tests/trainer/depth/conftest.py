"""A capture with known depth."""

from tests.stereo.captures import arc  # noqa: F401
