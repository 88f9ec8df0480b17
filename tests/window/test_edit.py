"""Selections in Edit Mode, in the window of a real Blender. Oracles: in the tests.

Needs the programs of `test_live.py`.
"""

from pathlib import Path

import numpy as np
import pytest

from tests.window.scenes import SCREEN, pixels, run_scene

pytestmark = pytest.mark.window

LONGEST = 200
FEW, MANY = 0.002, 0.05
"""Shares of the pixels of half a wall: at most a speck, and at least the vertices."""


@pytest.fixture(scope="module")
def seen(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict, Path]:
    """The results of `edit_scene.py`, and the folder of its pictures."""
    found, folder, output = run_scene("edit", tmp_path_factory, longest=LONGEST)
    assert "Traceback" not in output, output
    return found, folder


def orange(seen: tuple[dict, Path], name: str, half: str) -> float:
    """The share of a half's pixels with red above green above blue, as in Blender's selection
    colour, but not in the wall's colour or Solid's grey."""
    found, folder = seen
    left, right, bottom, top = found[half]
    red, green, blue = np.moveaxis(
        pixels(folder, name)[SCREEN[1] - top : SCREEN[1] - bottom, left:right], -1, 0
    )
    return float(np.mean((red > green + 40) & (green > blue + 10)))


def test_points_tell_what_is_selected(seen):
    """Oracle: the selected half, through Blender's own mesh."""
    assert seen[0]["none"] == 0
    assert orange(seen, "points_none", "upper") < FEW
    assert orange(seen, "points_none", "lower") < FEW
    assert orange(seen, "points_upper", "upper") > MANY
    assert orange(seen, "points_upper", "lower") < FEW


def test_splats_tell_what_is_selected(seen):
    """Oracle: the same."""
    assert orange(seen, "splats_upper", "upper") > 0.9
    assert orange(seen, "splats_upper", "lower") < FEW


EDGE = 4.0
"""Distance in pixels from a drawn line within which a vertex, as drawn without X-Ray, is on both
sides."""


@pytest.mark.parametrize("way", ["plain", "xray"])
def test_a_box_selects_the_splats_within_it(seen, way):
    """Oracle: the place of each splat by Blender's own projection."""
    flat = np.array(seen[0]["flat"])
    left, right, bottom, top = seen[0]["box"]
    inside = np.min(
        [flat[:, 0] - left, right - flat[:, 0], flat[:, 1] - bottom, top - flat[:, 1]], 0
    )
    _selected_are(seen, f"box_{way}", inside)


@pytest.mark.parametrize("way", ["plain", "xray"])
def test_a_lasso_selects_the_splats_within_it(seen, way):
    """Oracle: the side of each edge of the lasso on which Blender's own projection has a splat."""
    flat, corners = np.array(seen[0]["flat"]), np.array(seen[0]["lasso"], float)
    along = np.roll(corners, -1, axis=0) - corners
    normals = np.stack([-along[:, 1], along[:, 0]], 1) / np.linalg.norm(along, axis=1)[:, None]
    sides = np.einsum("pke,ke->pk", flat[:, None] - corners, normals)
    _selected_are(seen, f"lasso_{way}", sides.min(axis=1))


def _selected_are(seen: tuple[dict, Path], name: str, inside: np.ndarray) -> None:
    """Check that splats well inside are selected, those well outside are not, and both are many."""
    chosen = np.zeros(len(inside), bool)
    chosen[seen[0]["drawn"][name]] = True
    assert min((inside > EDGE).sum(), (inside < -EDGE).sum()) > 50
    assert chosen[inside > EDGE].all()
    assert not chosen[inside < -EDGE].any()


def test_large_objects_follow_a_selection_in_edit_mode(seen):
    """Oracle: the other half, after Blender's own operator and without leaving Edit Mode."""
    assert orange(seen, "splats_lower", "upper") < FEW
    assert orange(seen, "splats_lower", "lower") > 0.9
