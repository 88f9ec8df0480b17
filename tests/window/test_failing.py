"""A graphics card that fails, in the window of a real Blender. Oracles: in the tests.

Needs the programs of `test_live.py`.
"""

from pathlib import Path

import numpy as np
import pytest

from tests.window.scenes import SCREEN, pixels, run_scene

pytestmark = pytest.mark.window

LONGEST = 300


@pytest.fixture(scope="module")
def seen(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict, Path, str]:
    """The results of `failing_scene.py`, the folder of its pictures, and Blender's output."""
    return run_scene("failing", tmp_path_factory, longest=LONGEST)


def around(seen: tuple[dict, Path, str], name: str) -> np.ndarray:
    """[220, 300, 3] of the middle of the view, with splats and a mesh."""
    x, y = seen[0]["middle"]
    return pixels(seen[1], name)[SCREEN[1] - y - 110 :, x - 150 : x + 150][:220]


def test_a_card_that_fails_once_is_asked_again(seen):
    """Oracle: the same pixels as before, up to Blender's rounding of its lines; the sentence stays
    while the card pauses."""
    problems = seen[0]["problems"]
    assert "the add-on tries again" in problems["failed_once"]
    assert not problems["again"]
    apart = np.abs(around(seen, "again") - around(seen, "live"))
    assert apart.max() <= 10 and (apart > 2).mean() < 1e-3


def test_points_take_over(seen):
    """Oracle: the sentence with the card's own word, and a different picture."""
    for name in ("points", "refused"):
        said = seen[0]["problems"][name]
        assert "a driver's word" in said and "views show points" in said
        assert (np.abs(around(seen, name) - around(seen, "live")) > 20).mean() > 0.1


def test_drawing_error_is_shown_until_it_succeeds(seen):
    """Oracle: the sentence, which names the object; then the previous pixels."""
    problems = seen[0]["problems"]
    assert "wall has 1 splats whose scale is not finite" in problems["live_spoiled"]
    assert "wall" not in problems["live_mended"]
    apart = np.abs(around(seen, "live_mended") - around(seen, "live"))
    assert (apart > 4).mean() < 0.01


def test_refused_allocation_is_not_repeated(seen):
    """Oracle: the number of calls to the card: one, or one with three pauses."""
    calls = seen[0]["calls"]
    assert calls["refused"] == 1 and calls["for_good"] == 3


def test_the_view_says_so_itself(seen):
    """Oracle: letters of a colour that occurs nowhere else there, in the lower left."""
    x, y = seen[0]["corner"]
    part = np.s_[SCREEN[1] - y - 50 : SCREEN[1] - y, x : x + 300]
    amber = [np.ptp(pixels(seen[1], name)[part], axis=2) > 100 for name in ("refused", "said")]
    assert not amber[0].any() and amber[1].sum() > 200


def test_the_console_is_written_once(seen):
    """Oracle: one traceback for a row of failures, and one for a refusal."""
    output = seen[2]
    assert output.count("Traceback") == 2, output
    assert output.count("Splats cannot be drawn live.") == 2, output
    assert seen[0]["vertices"] and seen[0]["modifier"]
