"""Splats painted in the window of a real Blender, by a mouse that is simulated. Oracles: in the
tests; what is needed: `test_live.py`."""

from pathlib import Path

import numpy as np
import pytest

from tests.window.scenes import SCREEN, pixels, told

pytestmark = pytest.mark.window

LONGEST = 280
WALL, BRUSH = (204, 102, 51), (13, 51, 230)
"""8 bit."""


@pytest.fixture(scope="module")
def seen(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict, Path]:
    """What `paint_scene.py` saw, and the folder of its pictures."""
    found, folder, output = told(
        "paint", tmp_path_factory, "--enable-event-simulate", longest=LONGEST
    )
    assert "Traceback" not in output, output
    return found, folder


def color(seen: tuple[dict, Path], name: str, aside: int) -> np.ndarray:
    """[3] 8 bit, so many pixels to the right of the view's middle."""
    found, folder = seen
    x, y = found["middle"]
    # Off the brush's circles, which are drawn around the mouse.
    return pixels(folder, name)[SCREEN[1] - y, x + aside]


def test_a_stroke_shows_while_it_is_painted(seen):
    """Oracle: the brush's colour on the screen, to two levels of 8 bit, while the mesh is as it
    was; the wall's beside it."""
    found = seen[0]
    assert found["begun"] == ["RUNNING_MODAL"] and found["mesh_waits"] and found["mesh_follows"]
    for name in ("while", "color"):
        assert np.abs(color(seen, name, 0) - BRUSH).max() <= 2
        assert np.abs(color(seen, name, -120) - WALL).max() <= 2


def test_undo_takes_a_stroke_back_while_painting_goes_on(seen):
    """Oracle: the wall's colour on the screen, and the mesh to the bit; redo brings it again."""
    assert seen[0]["undone"] and seen[0]["redone"]
    assert np.abs(color(seen, "undone", -50) - WALL).max() <= 2


def test_opacity_erases(seen):
    """Oracle: Solid shading's grey where the brush went, its colour of before beside it."""
    assert np.ptp(color(seen, "erased", -60)) < 12
    assert np.abs(color(seen, "erased", 50) - BRUSH).max() <= 2


def test_what_keys_do(seen):
    """Oracle: what Blender has afterwards: splats selected, a view turned, nothing deleted."""
    found = seen[0]
    assert 10 < found["selected"] < 1000
    assert found["turned"] and found["kept"] and found["ended"]


def test_the_tool_paints_a_stroke_a_drag(seen):
    """Oracle: the mesh, and whether painting is under way; the radius that its keys leave."""
    found = seen[0]
    assert found["tool_begins"] and found["tool_paints"] and found["tool_ends"]
    first, by_key, by_mouse = found["radius"]
    assert first < by_key < by_mouse


def test_painting_ends_with_the_addon(seen):
    """Oracle: the circle's handle, and the mesh as it was before the stroke under way."""
    assert seen[0]["begun_again"] == ["RUNNING_MODAL"] and seen[0]["ended_with_the_addon"]
