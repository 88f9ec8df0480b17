"""The world cut into cells; oracle: counts, and the expected cells of a street along x."""

import numpy as np
import pytest

from gscore.blocks.block_cells import make_cells

LEVEL = np.eye(4)[None].repeat(5, axis=0)
"""Cameras with +y down."""


@pytest.mark.parametrize("count", [2, 3, 5, 8])
def test_cells_fill_the_world_and_share_the_work(count: int) -> None:
    """Oracle: one cell for each point, far ones too; weights even within 5 %."""
    rng = np.random.default_rng(count)
    points = rng.normal(size=(20_000, 3)) * [30, 1, 10]
    weights = rng.integers(2, 9, 20_000)
    cells = make_cells(points, weights, LEVEL, count)
    inside = cells.contains(np.concatenate([points, 1e9 * rng.normal(size=(1000, 3))]))
    assert (inside.sum(axis=0) == 1).all()
    shares = inside[:, :20_000] @ weights / weights.sum()
    assert shares == pytest.approx(np.full(count, 1 / count), abs=0.05 / count)


def test_cells_stand_upright_and_cut_the_longer_side() -> None:
    """Oracle: the street's own axes; two cells part at half of its length."""
    points = np.random.default_rng(0).uniform([0, -9, 0], [40, 9, 3], (5000, 3))
    cells = make_cells(points, np.ones(5000), LEVEL, 2)
    assert np.abs(cells.axes) == pytest.approx(np.array([[1.0, 0, 0], [0, 0, 1]]), abs=0.02)
    assert cells.contains(np.array([[19.0, 50, 1], [21, -50, 1]])).sum(axis=1).tolist() == [1, 1]


def test_cameras_turned_at_will_say_nothing_of_what_is_up() -> None:
    """Oracle: the plane of the points, where the cameras' upward directions cancel."""
    turned = np.stack([np.diag([1.0, sign, sign, 1]) for sign in (1, -1)])
    points = np.random.default_rng(1).uniform([0, 0, 0], [0.1, 40, 9], (5000, 3))
    axes = make_cells(points, np.ones(5000), turned, 2).axes
    assert np.abs(axes) == pytest.approx(np.array([[0.0, 1, 0], [0, 0, 1]]), abs=0.02)


def test_cells_stand_upright_as_the_capture_states_it() -> None:
    """Oracle: a stated up across the cameras' own."""
    points = np.random.default_rng(0).uniform([0, -9, 0], [40, 9, 3], (5000, 3))
    cells = make_cells(points, np.ones(5000), LEVEL, 2, up=np.array([0.0, 0, 1]))
    assert np.abs(cells.axes) == pytest.approx(np.array([[1.0, 0, 0], [0, 1, 0]]), abs=0.04)


def test_wider_cells() -> None:
    """Oracle: two cells of a street of 40 reach 20 % of their extent over the seam."""
    points = np.random.default_rng(0).uniform([0, 0, 0], [40, 1, 3], (20_000, 3))
    cells = make_cells(points, np.ones(20_000), LEVEL, 2)
    around = cells.around(points, 0.2)
    assert around.any(axis=0).all()
    both = points[around.all(axis=0), 0]
    assert (both.min(), both.max()) == pytest.approx((16, 24), abs=0.4)
