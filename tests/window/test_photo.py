"""A camera's photo and live splats, in the window of a real Blender. Oracles: in the tests.

Needs the programs of `test_live.py`.
"""

from pathlib import Path

import numpy as np
import pytest

from tests.window.scenes import SCREEN, pixels, run_scene

pytestmark = pytest.mark.window

LONGEST = 200
COLOR = (204, 102, 51)
"""Colour of the wall, 8 bit."""


@pytest.fixture(scope="module")
def seen(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict, Path]:
    """The results of `photo_scene.py`, and the folder of its pictures."""
    found, folder, output = run_scene("photo", tmp_path_factory, longest=LONGEST)
    assert "Traceback" not in output, output
    return found, folder


def around(seen: tuple[dict, Path], name: str, half: int = 25) -> np.ndarray:
    """[2 half, 2 half, 3] of the middle of the view, with the wall."""
    x, y = seen[0]["middle"]
    y = SCREEN[1] - y
    return pixels(seen[1], name)[y - half : y + half, x - half : x + half]


@pytest.mark.parametrize("shading", ["solid", "rendered"])
def test_splats_lie_over_a_photo_behind_them(seen, shading):
    """Oracle: the wall's colour; the photo where there is none. In Rendered shading too, although
    Blender would draw the photo over the engine's own picture."""
    assert np.abs(around(seen, f"{shading}_back") - COLOR).max() <= 2
    wide, alone = (around(seen, f"{shading}_{n}", half=180) for n in ("back", "alone"))
    assert np.std(alone) > 20
    beside = np.s_[140:220, :40]
    assert np.abs(wide[beside] - alone[beside]).mean() < 1


def test_the_engines_picture_lies_over_a_photo_behind_it(seen):
    """Oracle: the wall's colour, the photo next to it, and between them the edge of the wall as it
    is drawn live."""
    assert np.abs(around(seen, "still_back") - COLOR).max() <= 2
    still, live, alone = (
        around(seen, name, half=180) for name in ("still_back", "rendered_back", "rendered_alone")
    )
    beside = np.s_[140:220, :40]
    assert np.abs(still[beside] - alone[beside]).mean() < 1
    assert np.abs(still - live).mean() < 1 and np.abs(live - alone).mean() > 10


@pytest.mark.parametrize("name", ["held_still", "held_live"])
def test_a_hole_shows_the_photo_behind_it(seen, name):
    """Oracle: the photo in the middle of the hole; the wall's colour around it, the photo next to
    that."""
    held, alone = (around(seen, one, half=180) for one in (name, "rendered_alone"))
    middle, beside = np.s_[170:190, 170:190], np.s_[140:220, :40]
    assert np.abs(held[middle] - alone[middle]).mean() < 2
    assert np.abs(held[beside] - alone[beside]).mean() < 1
    assert (np.abs(held - COLOR).max(axis=2) <= 2).mean() > 0.05


def test_no_photo_over_a_free_view(seen):
    """Oracle: the same view without a photo: the wall, small, on the grey of the world."""
    found, bare = (around(seen, f"elsewhere{end}", half=100) for end in ("", "_bare"))
    assert np.abs(found - bare).max() <= 2 and np.ptp(bare) > 50


@pytest.mark.parametrize("shading", ["solid", "rendered"])
def test_a_photo_lies_over_splats_behind_it(seen, shading):
    """Oracle: the photo without splats, as Blender draws it."""
    front, alone = (around(seen, f"{shading}_{n}") for n in ("front", "alone"))
    assert np.abs(front - alone).mean() < 2 and np.std(alone) > 20


def test_a_photo_shows_as_much_as_was_chosen(seen):
    """Oracle: the mean of the wall's light and the photo's."""
    light = (around(seen, "solid_alone") / 255) ** 2.2 + (np.array(COLOR) / 255) ** 2.2
    want = 255 * (light / 2) ** (1 / 2.2)
    assert np.abs(around(seen, "solid_half") - want).mean() < 2


def test_a_sequence_of_which_no_frame_is_known_hides_nothing(seen):
    """Oracle: the wall's colour."""
    assert np.abs(around(seen, "sequence") - COLOR).max() <= 2


def test_a_photo_that_is_not_there_hides_nothing(seen):
    """Oracle: the wall's colour."""
    assert np.abs(around(seen, "lost") - COLOR).max() <= 2
