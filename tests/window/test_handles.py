"""Handles of histograms, dragged in the window of a real Blender by a simulated mouse. Oracles: in
the tests; required programs: `test_live.py`."""

from pathlib import Path

import numpy as np
import pytest

from addon.histograms.counting import OPACITY, SIZE, of_sizes
from tests.window.scenes import SCREEN, pixels, run_scene

pytestmark = pytest.mark.window

PIXEL = 0.006
"""Width of a pixel as a share of a histogram's width, rounded up."""


@pytest.fixture(scope="module")
def seen(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict, Path]:
    """The results of `handles_scene.py`, and the folder of its pictures."""
    found, folder, output = run_scene(
        "handles", tmp_path_factory, "--enable-event-simulate", longest=120
    )
    assert "Traceback" not in output, output
    return found, folder


def test_opacity_goes_with_the_mouse(seen):
    """Oracle: the place on an axis from 0 to 1; a tenth of the way with Shift."""
    found = seen[0]
    assert found["dragged"] == [pytest.approx(0.5, abs=PIXEL), 0.0, 0.0]
    assert found["fine"][0] == pytest.approx(found["dragged"][0] + 0.025, abs=PIXEL)


def test_each_drag_is_an_undo_step(seen):
    """Oracle: the previous limit."""
    assert seen[0]["undone"] == seen[0]["dragged"]


def test_escape_gives_a_drag_up(seen):
    """Oracle: the limit during the drag, and the previous one."""
    found = seen[0]
    assert found["while"][0] == pytest.approx(0.9, abs=PIXEL)
    assert found["cancelled"] == found["undone"]


def test_sizes_have_a_handle_at_each_end(seen):
    """Oracle: the axis of the scene's sizes; a handle does not pass the other."""
    found = seen[0]
    axis = of_sizes(np.geomspace(0.01, 0.1, 41 * 41))
    _, low, high = found["sizes"]
    assert axis.place(low) == pytest.approx(0.2, abs=PIXEL)
    assert axis.place(high) == pytest.approx(0.7, abs=PIXEL)
    _, low, high = found["ends"]
    assert high == 0.0 and axis.place(low) == pytest.approx(1.0, abs=PIXEL)


def test_handles_that_stand_together_go_either_way(seen):
    """Oracle: the limit that moved, and the other one, which stayed; 0.0316 is the middle."""
    axis = of_sizes(np.geomspace(0.01, 0.1, 41 * 41))
    (_, low, up), (_, down, high) = seen[0]["together"]
    assert low == high == pytest.approx(0.0316)
    assert axis.place(up) == pytest.approx(0.8, abs=2 * PIXEL)
    assert axis.place(down) == pytest.approx(0.3, abs=2 * PIXEL)


def test_a_drag_is_of_the_splats_that_it_was_begun_on(seen):
    """Oracle: the limits by hand; other splats that become active keep theirs, Esc restores those
    of the first, also where the histograms were removed meanwhile, or the splats."""
    found = seen[0]
    assert found["two"] == [pytest.approx(0.3, abs=PIXEL), pytest.approx(0.7)]
    assert found["two_after"] == [0.0, pytest.approx(0.7)]
    assert found["switched_off"] == pytest.approx(0.7)
    assert found["deleted"] == [0.0, 0.0, 0.0]


def bars(seen: tuple[dict, Path], name: str, kind: str) -> tuple[np.ndarray, np.ndarray]:
    """[W] bool each: columns of a histogram with blue, and with grey, near the axis."""
    found, folder = seen
    left, bottom, width, _ = map(int, found["boxes"][kind])
    row = pixels(folder, name)[SCREEN[1] - bottom - 4, left : left + width]
    blue = row[:, 2] - row[:, 0] > 60
    grey = (np.ptp(row, axis=1) < 12) & (row[:, 0] > 70)
    return blue, grey


def test_hidden_part_is_grey(seen):
    """Oracle: even opacities, so that there are bars everywhere: blue above the handle, grey below;
    the same picture as without when they are switched off."""
    blue, grey = bars(seen, "on", OPACITY)
    assert blue.mean() > 0.9 and grey.mean() < 0.05
    blue, grey = bars(seen, "dragged", OPACITY)
    half = len(blue) // 2
    assert blue[half + 8 :].mean() > 0.9 and not blue[: half - 8].any()
    assert grey[: half - 8].mean() > 0.9
    view = (slice(100, 610), slice(40, 780))  # without the toolbars around it
    off, on, again = (pixels(seen[1], name)[view] for name in ("off", "on", "off_again"))
    assert np.abs(off - on).max() > 100 and np.abs(off - again).max() <= 2
    dragged, same = (pixels(seen[1], name)[view] for name in ("dragged", "not_in_renders"))
    assert np.abs(dragged - same).max() <= 2 and np.abs(dragged - off)[:300].max() > 100
    blue, _ = bars(seen, "sizes", SIZE)
    assert 0.3 < blue.mean() < 0.6
