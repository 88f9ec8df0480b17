"""Depth buffer of a view; oracle: the drawn depths."""

import gpu
import numpy as np
import pytest

from addon.live.depths import Depths
from tests.addon.live import graphics

pytestmark = pytest.mark.graphics


@pytest.fixture(scope="module")
def drawn_to():
    """Write depths [H, W] to a target, and read them back by the given `Depths`."""
    graphics.begin()

    def read(depths: Depths, value: float, size: tuple[int, int] = (6, 4)):
        target = gpu.types.GPUOffScreen(*size)
        with target.bind():
            gpu.state.active_framebuffer_get().clear(depth=value)
            return depths.read(0, 0, *size)

    return read


def test_the_texture_stays_while_depths_do(drawn_to):
    """Oracle: the drawn depths, and the identity of the texture."""
    depths = Depths()
    first = drawn_to(depths, 0.25)
    found = first.read()
    found.dimensions = 24
    assert np.abs(np.array(found, np.float32) - 0.25).max() < 1e-6
    assert drawn_to(depths, 0.25) is first
    second = drawn_to(depths, 0.250001)
    assert second is not first and drawn_to(depths, 0.250001) is second
    assert drawn_to(depths, 0.250001, (4, 6)) is not second
