"""Splats in the window of a real Blender, on a virtual screen. Oracles: in the tests.

Needs a Blender of 4.2 or later, Xvfb and ImageMagick: `make test-window`. GSCORE_BLENDER names the
program; the default is `blender`.
"""

from pathlib import Path

import numpy as np
import pytest

from tests.window.scenes import SCREEN, pixels, run_scene

pytestmark = pytest.mark.window

LONGEST = 500
COLOR = (204, 102, 51)
"""Colour of the wall, 8 bit."""


@pytest.fixture(scope="module")
def seen(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict, Path]:
    """The results of `live_scene.py`, and the folder of its pictures."""
    found, folder, output = run_scene(
        "live", tmp_path_factory, "--enable-event-simulate", longest=LONGEST
    )
    assert "Traceback" not in output, output
    return found, folder


def middle(seen: tuple[dict, Path], name: str, aside: int = 0) -> np.ndarray:
    """[3] colour in the middle of the view, or some pixels to its right."""
    found, folder = seen
    x, y = found["middle"]
    return pixels(folder, name)[SCREEN[1] - y, x + aside]


def test_colours_of_splats_reach_the_screen(seen):
    """Oracle: the wall's colour, to two levels of 8 bit: Solid shading adds nothing to it."""
    assert seen[0]["display"] == "SPLATS"
    assert np.abs(middle(seen, "wall") - COLOR).max() <= 2


def test_stretched_objects_are_named_instead_of_drawn(seen):
    """Oracle: the sentence, and the grey of the empty view in place of the wall's colour."""
    assert "wall cannot be rendered" in seen[0]["uneven"] and "unevenly" in seen[0]["uneven"]
    for aside in (0, 80):
        assert np.ptp(middle(seen, "uneven", aside)) < 10


def test_dark_colours_reach_the_screen(seen):
    """Oracle: a wall of few levels of 8 bit, to one of them: overlays of a view's picture are
    stored so that 1 to 5 would become 0 or 6."""
    assert np.abs(middle(seen, "dark") - (5, 4, 3)).max() <= 1


def test_splats_come_without_being_touched(seen):
    """Oracle: the copy three seconds after one redraw, each of which copies one attribute."""
    assert seen[0]["by_itself"]


def test_meshes_before_and_behind_splats(seen):
    """Oracle: the wall's colour with the mesh behind it, Solid's grey with it in front."""
    assert np.ptp(middle(seen, "plate_before")) < 10
    assert np.abs(middle(seen, "plate_before", aside=80) - COLOR).max() <= 2
    assert np.abs(middle(seen, "plate_behind") - COLOR).max() <= 2


def test_meshes_before_and_behind_splats_on_the_move(seen):
    """Oracle: as at rest, though no depths are read then."""
    assert all(seen[0]["moving"])
    assert np.ptp(middle(seen, "plate_before_moving")) < 10
    assert np.abs(middle(seen, "plate_before_moving", aside=80) - COLOR).max() <= 2
    assert np.abs(middle(seen, "plate_behind_moving") - COLOR).max() <= 2


@pytest.mark.parametrize("moving", ["", "_moving"])
def test_lines_before_and_behind_splats(seen, moving):
    """Oracle: the wall's colour with the edge behind it; a theme's black with it in front, or
    behind and *In Front*."""
    found, folder = seen
    x, y = found["middle"]
    part = np.s_[SCREEN[1] - y - 5 : SCREEN[1] - y + 5, x + 5 : x + 20]
    names = (f"line_{n}{moving}" for n in ("before", "behind", "in_front"))
    before, behind, in_front = (pixels(folder, name)[part] for name in names)
    assert np.abs(behind - COLOR).max() <= 2
    for line in (before, in_front):
        assert (line.max(axis=2) < 100).any(axis=0).all()


def test_clipped_splats_are_gone(seen):
    """Oracle: the wall's colour within the clipping border, the background outside and beyond the
    end; the wall again without clipping."""
    nothing = middle(seen, "wall", aside=250)
    assert np.ptp(nothing) < 10
    assert np.abs(middle(seen, "clipped") - COLOR).max() <= 2
    assert np.array_equal(middle(seen, "clipped", aside=80), nothing)
    assert np.abs(middle(seen, "unclipped", aside=80) - COLOR).max() <= 2
    assert np.array_equal(middle(seen, "beyond_the_end"), nothing)


def test_a_picture_is_kept_beside_a_mesh(seen):
    """Oracle: the number of pictures requested from the card; one more after the mesh has moved."""
    found = seen[0]["with_mesh"]
    assert found["again"] == 0 < found["moved"]


def test_which_objects_are_shown(seen):
    """Oracle: the objects that a user has hidden, displayed otherwise, or left out of the local
    view."""
    found = seen[0]
    assert found["both"] == ["blob", "wall"]
    assert found["hidden"] == found["as_points"] == ["wall"]
    assert found["local"] == ["blob"]


def test_a_picture_is_kept_until_the_view_changes(seen):
    """Oracle: the number of pictures requested from the card; the same screen after a turn and
    back, up to Blender's rounding of smoothed lines."""
    found, folder = seen
    assert found["pictures"]["again"] == 0 < found["pictures"]["turned"]
    apart = np.abs(pixels(folder, "both") - pixels(folder, "both_again"))
    assert apart.max() <= 1 and (apart > 0).mean() < 1e-3


def test_the_exact_picture_takes_over(seen):
    """Oracle: the picture of the graphics card, to two levels of 8 bit where splats are dense; the
    background is the world's and not Solid's."""
    _, folder = seen
    live, exact = (pixels(folder, name) for name in ("both", "exact"))
    x, y = seen[0]["middle"]
    part = np.s_[SCREEN[1] - y - 60 : SCREEN[1] - y + 60, x - 60 : x + 60]
    assert np.abs(live[part] - exact[part]).max() <= 2
    assert np.std(exact[part]) > 5


@pytest.mark.parametrize("transform", ["Standard", "Raw"])
def test_a_still_camera_view_is_the_render(seen, transform):
    """Oracle: the PNG of F12, pixel by pixel, except at the view's edge, where Blender draws its
    corners and the arrows of closed regions."""
    found, folder = seen
    left, bottom, width, height = found["view"]
    rows = slice(SCREEN[1] - bottom - height, SCREEN[1] - bottom)
    view = pixels(folder, f"camera_{transform}")[rows, left : left + width]
    written = pixels(folder, f"f12_{transform}", (width, height))
    assert np.std(written, axis=(0, 1)).max() > 20
    inside = np.s_[16:-16, 16:-16]
    apart = np.abs(view - written)[inside].max(axis=-1)
    assert np.quantile(apart, 0.999) <= 2 and apart.max() <= 3


@pytest.mark.parametrize("shading", ["solid", "material", "rendered"])
def test_gizmos_lie_over_splats(seen, shading):
    """Oracle: the theme's colours of the axes, where only splats are without the gizmo."""
    found, folder = seen
    x, y = found["middle"][0], SCREEN[1] - found["middle"][1]
    arms = np.s_[y - 3 : y + 3, x + 20 : x + 90], np.s_[y - 90 : y - 20, x - 3 : x + 3]
    for axis, arm in zip(found["axes"], arms, strict=True):
        off, on = (pixels(folder, f"gizmo_{shading}_{switch}")[arm] for switch in ("off", "on"))
        near = [np.abs(picture - 255 * np.array(axis)).max(axis=-1) < 60 for picture in (on, off)]
        assert (near[0] & ~near[1]).sum() > 20


def test_the_addon_can_be_disabled_and_enabled_in_a_window(seen):
    """Oracle: no splats, then the same picture as before; the display of the wall, and the picture
    once it is displayed otherwise."""
    found, folder = seen
    before, off, again = (pixels(folder, name) for name in ("before_off", "off", "on_again"))
    x, y = found["middle"]
    part = np.s_[SCREEN[1] - y - 60 : SCREEN[1] - y + 60, x - 60 : x + 60]
    assert np.abs(off[part] - before[part]).mean() > 20
    apart = np.abs(again[part] - before[part])
    assert apart.max() <= 1
    assert found["display_again"] == "SPLATS"
    assert found["shown_again"] == ["blob"]
