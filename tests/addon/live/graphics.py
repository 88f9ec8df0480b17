"""Graphics for tests, in Blenders that offer them without a window (5.2 and later)."""

import gpu
import pytest


def begin() -> None:
    """Make them ready, or skip the test."""
    if not hasattr(gpu, "init"):
        pytest.skip("this Blender has no graphics without a window")
    try:
        gpu.init()
    except SystemError as error:
        pytest.skip(f"no graphics: {error}")
