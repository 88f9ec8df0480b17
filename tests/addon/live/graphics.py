"""Graphics for tests, in Blenders that offer them without a window (5.2 and later)."""

import os

import gpu
import pytest


def begin() -> None:
    """Initialise the graphics, or skip the test.

    GSCORE_GPU_BACKEND chooses the backend, `opengl` or `vulkan`; without it Blender's default is
    tested.
    """
    if not hasattr(gpu, "init"):
        pytest.skip("this Blender has no graphics without a window")
    try:
        gpu.init()
    except SystemError as error:
        pytest.skip(f"no graphics: {error}")
    wanted, found = os.environ.get("GSCORE_GPU_BACKEND"), gpu.platform.backend_type_get()
    if wanted and wanted.upper() != found:
        hint = " (Debian: mesa-vulkan-drivers)" if wanted == "vulkan" else ""
        pytest.skip(f"no driver for {wanted}{hint}: Blender uses {found}")
