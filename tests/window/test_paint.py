"""Splats painted in the window of a real Blender, by a simulated mouse. Oracles: in the tests;
required programs: `test_live.py`."""

from pathlib import Path

import numpy as np
import pytest

from tests.window.scenes import SCREEN, pixels, run_scene

pytestmark = pytest.mark.window

LONGEST = 280
WALL, BRUSH = (204, 102, 51), (13, 51, 230)
"""8 bit."""


@pytest.fixture(scope="module")
def seen(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict, Path]:
    """The results of `paint_scene.py`, and the folder of its pictures."""
    found, folder, output = run_scene(
        "paint", tmp_path_factory, "--enable-event-simulate", longest=LONGEST
    )
    assert "Traceback" not in output, output
    return found, folder


def color(seen: tuple[dict, Path], name: str, aside: int) -> np.ndarray:
    """[3] 8 bit, this number of pixels to the right of the view's middle."""
    found, folder = seen
    x, y = found["middle"]
    # Off the brush's circles, which are drawn around the mouse.
    return pixels(folder, name)[SCREEN[1] - y, x + aside]


def test_a_stroke_shows_while_it_is_painted(seen):
    """Oracle: the brush's colour on the screen, to two levels of 8 bit, with an unchanged mesh; the
    wall's next to it."""
    found = seen[0]
    assert found["begun"] == ["RUNNING_MODAL"] and found["mesh_waits"] and found["mesh_follows"]
    for name in ("while", "color"):
        assert np.abs(color(seen, name, 0) - BRUSH).max() <= 2
        assert np.abs(color(seen, name, -120) - WALL).max() <= 2


def test_undo_takes_a_stroke_back_while_painting_goes_on(seen):
    """Oracle: the wall's colour on the screen, and the mesh to the bit; redo restores the
    stroke."""
    assert seen[0]["undone"] and seen[0]["redone"]
    assert np.abs(color(seen, "undone", -50) - WALL).max() <= 2


def test_opacity_erases(seen):
    """Oracle: Solid shading's grey along the stroke, the previous colour next to it."""
    assert np.ptp(color(seen, "erased", -60)) < 12
    assert np.abs(color(seen, "erased", 50) - BRUSH).max() <= 2


def test_keys_while_painting(seen):
    """Oracle: Blender's state afterwards: splats selected, a view turned, none deleted."""
    found = seen[0]
    assert 10 < found["selected"] < 1000
    assert found["turned"] and found["kept"] and found["ended"]


def test_the_tool_paints_a_stroke_a_drag(seen):
    """Oracle: the mesh, and whether painting is running; the radius set by its keys."""
    found = seen[0]
    assert found["tool_begins"] and found["tool_paints"] and found["tool_ends"]
    first, by_key, by_mouse = found["radius"]
    assert first < by_key < by_mouse


def test_painting_ends_with_the_addon(seen):
    """Oracle: the circle's handle, and the mesh before the unfinished stroke."""
    assert seen[0]["begun_again"] == ["RUNNING_MODAL"] and seen[0]["ended_with_the_addon"]
