"""Handles of histograms. Oracle: positions by hand, and the settings of an object."""

from types import SimpleNamespace

import numpy as np
import pytest

from addon.histograms.boxes import Box, OverlappingRegions, placed
from addon.histograms.counting import OPACITY, SIZE, of_opacities, of_sizes
from addon.histograms.limits import handles, limits_of

SIZES = of_sizes(np.geomspace(0.01, 1, 10_001))


def thing(**limits: float) -> SimpleNamespace:
    """A fake object with filters."""
    none = {"opacity_min": 0.0, "size_min": 0.0, "size_max": 0.0}
    return SimpleNamespace(gscore=SimpleNamespace(**none | limits))


def test_a_handle_sets_what_lies_below_it():
    """Oracle: the even axis of opacities; the decades of sizes."""
    ob, (only,) = thing(), handles(OPACITY)
    only.move(of_opacities(np.zeros(3)), ob, 0.25)
    assert ob.gscore.opacity_min == pytest.approx(0.25)
    for handle in handles(SIZE):
        handle.move(SIZES, ob, 0.5 + 0.25 * handle.is_upper)
    assert ob.gscore.size_min == pytest.approx(0.1, rel=0.02)
    assert ob.gscore.size_max == pytest.approx(10**-0.5, rel=0.02)
    assert [handle.place(SIZES, ob) for handle in handles(SIZE)] == pytest.approx([0.5, 0.75])
    assert limits_of(ob, SIZE) == (ob.gscore.size_min, ob.gscore.size_max)


def test_at_its_end_a_handle_limits_nothing():
    """Oracle: 0, and the position of a handle without a limit."""
    ob = thing(size_min=0.1, size_max=0.5)
    low, high = handles(SIZE)
    low.move(SIZES, ob, -0.2)
    high.move(SIZES, ob, 1.3)
    assert limits_of(ob, SIZE) == (0.0, 0.0)
    assert (low.place(SIZES, ob), high.place(SIZES, ob)) == (0.0, 1.0)


def test_handles_do_not_pass_each_other():
    """Oracle: the other's position."""
    ob = thing(size_min=0.1, size_max=0.5)
    low, high = handles(SIZE)
    low.move(SIZES, ob, 0.99)
    assert ob.gscore.size_min == pytest.approx(0.5)
    high.move(SIZES, ob, 0.01)
    assert ob.gscore.size_max == pytest.approx(0.5)


def test_boxes_lie_free():
    """Oracle: regions over the view at either side, above and below."""
    over = OverlappingRegions(
        left=[Box(0, 0, 60, 600)],
        right=[Box(760, 0, 240, 600)],
        above=[Box(0, 570, 1000, 30)],
        below=[Box(0, 0, 1000, 40)],
        floating=[Box(70, 40, 30, 300)],
    )
    first, second = placed(Box(0, 0, 1000, 600), over, 2, 1.0)
    assert 60 < first.x < first.right < second.x < second.right < 760
    assert first.y == second.y > 40 and first.width == second.width
    assert second.right == 760 - 16


def test_boxes_stand_above_what_floats_in_their_way():
    """Oracle: the upper end of the overlapping region."""
    view = Box(0, 0, 800, 600)
    plain = placed(view, OverlappingRegions(), 2, 1.0)
    panel = Box(20, 20, 170, 25)
    assert placed(view, OverlappingRegions(floating=[panel]), 2, 1.0) == plain
    raised = placed(view, OverlappingRegions(floating=[panel, Box(20, 20, 350, 40)]), 2, 1.0)
    assert all(box.y > 60 for box in raised)
    assert [box.x for box in raised] == [box.x for box in plain]


@pytest.mark.parametrize(
    ("width", "height", "count"),
    [(330, 600, 2), (330, 230, 2), (330, 220, 1), (330, 120, 0), (140, 600, 0), (800, 130, 2)],
)
def test_there_are_as_many_boxes_as_there_is_room_for(width, height, count):
    """Oracle: heights by hand: 28 + 70 + 28 for one, 98 more for a second above it."""
    view = Box(0, 0, width, height)
    found = placed(view, OverlappingRegions(), 2, 1.0)
    assert len(found) == count and all(box.top + 28 <= height for box in found)
    if count == 2 and width < 500:
        assert found[0].x == found[1].x and found[0].top < found[1].y
