"""Soft Splats by EEVEE, in the window of a real Blender. Oracle: `gscore.render`.

Needs the programs of `test_live.py`.
"""

import numpy as np
import pytest

from tests.window.scenes import pixels, run_scene

pytestmark = pytest.mark.window

OPAQUE = 0.99
"""Opacity at which gscore stops; EEVEE does not."""


def test_eevee_shows_the_color_from_here(tmp_path_factory):
    """Oracle: the colors of degree 3 of nine opaque balls at their middles, viewed from the side,
    to the mean error on the Blender page, and single ones as in Cycles."""
    found, folder, output = run_scene("soft", tmp_path_factory, longest=400)
    assert "Traceback" not in output, output
    x, y = np.transpose(found["places"])
    shown = OPAQUE * pixels(folder, "f12", (200, 200))[y, x] / 255
    wanted = np.clip(found["wanted"], 0, 1)
    assert np.ptp(wanted) > 0.3
    apart = shown - wanted
    assert np.abs(apart.mean(axis=0)).max() <= 1 / 255
    assert np.abs(apart).max() <= 3 / 255
