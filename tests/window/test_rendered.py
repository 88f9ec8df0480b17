"""Rendered shading of the engine in the window of a real Blender. Oracles: in the tests.

As test_live.py: Xvfb, ImageMagick, and a Blender of 4.2 or later.
"""

from pathlib import Path

import numpy as np
import pytest

from tests.window.scenes import SCREEN, pixels, run_scene

pytestmark = pytest.mark.window

LONGEST = 400
COLOR = np.array([204, 102, 51])
"""Colour of the wall, 8 bit."""
TINTED = 0.35 * COLOR + 0.65 * 255 * np.array([1.0, 0.5, 0.05])
OFFSET = 107
"""Pixels from the middle to the hidden or selected part."""


@pytest.fixture(scope="module")
def seen(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict, Path]:
    """The results of `rendered_scene.py`, and the folder of its pictures."""
    found, folder, output = run_scene("rendered", tmp_path_factory, longest=LONGEST)
    assert "Traceback" not in output, output
    return found, folder


def around(seen: tuple[dict, Path], name: str, right: int = 0, up: int = 0) -> np.ndarray:
    """[3] median color of some pixels around a place, from the middle of the view."""
    x, y = seen[0]["middle"][0] + right, SCREEN[1] - seen[0]["middle"][1] - up
    return np.median(pixels(seen[1], name)[y - 4 : y + 5, x - 4 : x + 5], axis=(0, 1))


def is_wall(color: np.ndarray) -> bool:
    """True if a color is the wall's, to two levels of 8 bit."""
    return np.abs(color - COLOR).max() <= 2


PARTS = ["region", "region_moving", "region_material", "region_of_camera"]


@pytest.mark.parametrize("name", PARTS)
def test_a_region_alone_is_drawn(seen: tuple[dict, Path], name: str) -> None:
    """Oracle: the wall's color up to the edges of the requested region, one pixel of which may be
    Blender's line; the grey of the empty view beyond. By the operator of Ctrl-B."""
    assert seen[0]["moving"] and seen[0]["scenes_own"]
    left, right, bottom, top = seen[0]["region"]
    x, y = (left + right) // 2, (bottom + top) // 2
    inside = [(left + 8, y), (right - 8, y), (x, bottom + 8), (x, top - 8)]
    beside = [(left - 8, y), (right + 8, y), (x, bottom - 8), (x, top + 8)]
    assert all(is_wall(around(seen, name, *place)) for place in inside)
    for place in beside:
        color = around(seen, name, *place)
        assert np.ptp(color) < 10 < color.min() < 100
    picture = pixels(seen[1], name)
    middle = seen[0]["middle"]
    wall = (np.abs(picture - COLOR).max(axis=2) <= 2)[:, : middle[0] + 200]
    rows, columns = np.nonzero(wall)
    edges = [columns.min() - middle[0], columns.max() + 1 - middle[0]]
    edges += [SCREEN[1] - rows.max() - 1 - middle[1], SCREEN[1] - rows.min() - middle[1]]
    assert np.abs(np.subtract(edges, (left, right, bottom, top))).max() <= 2


@pytest.mark.parametrize("name", ["region_solid", "everything"])
def test_elsewhere_everything_is_drawn(seen: tuple[dict, Path], name: str) -> None:
    """Oracle: no wall's color next to the region: Solid shading has none, and the region was
    removed."""
    left, right, bottom, top = seen[0]["region"]
    for place in ((left - 8, top), (right + 8, bottom)):
        assert is_wall(around(seen, name, *place))


def test_edit_mode_looks_as_in_solid_shading(seen: tuple[dict, Path]) -> None:
    """Oracle: black where the wall is hidden, the tint where it is selected, with overlays; the
    wall in Object Mode."""
    assert around(seen, "edited", -OFFSET).max() < 5
    assert np.abs(around(seen, "edited", OFFSET) - TINTED).max() <= 3
    assert around(seen, "edited_without_overlays", -OFFSET).max() < 5
    for aside in (0, OFFSET):
        assert is_wall(around(seen, "edited_without_overlays", aside))
    for aside in (-OFFSET, 0, OFFSET):
        assert is_wall(around(seen, "not_edited", aside))


def lines(seen: tuple[dict, Path], name: str) -> int:
    """Number of text lines in the upper left of the view."""
    left, bottom, _, height = seen[0]["view"]
    top = SCREEN[1] - bottom - height
    part = pixels(seen[1], name)[top : top + 120, left : left + 200]
    bright = (part.min(axis=2) > 150).any(axis=1)
    return int((bright[1:] & ~bright[:-1]).sum())


def test_render_only_effects_are_named(seen: tuple[dict, Path]) -> None:
    """Oracle: one line more than Blender's own, only through a camera that blurs."""
    sharp, lens, no_camera = (lines(seen, name) for name in ("sharp", "lens", "no_camera"))
    assert sharp == no_camera >= 2 and lens == sharp + 1
