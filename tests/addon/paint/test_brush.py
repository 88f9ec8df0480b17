"""Formulas of the brush, and its path. Oracles: the same formulas, point by point in Python."""

import math
from itertools import pairwise

import numpy as np
import pytest

from addon.paint.brush import COLOR, OPACITY, Brush, Stroke
from tests.addon.splat_scenes import SH_C0


def falloff(distance: float, radius: float, hardness: float) -> float:
    """1 within the hard part, 0 from the radius on, a smooth step between them."""
    if distance >= radius:
        return 0.0
    if distance <= hardness * radius:
        return 1.0
    u = (distance / radius - hardness) / (1 - hardness)
    return 1 - u**2 * (3 - 2 * u)


def from_way(point: np.ndarray, way: list[np.ndarray]) -> float:
    """Smallest distance of a point from a polyline."""
    best = math.dist(point, way[0])
    for a, b in pairwise(way):
        length = math.dist(a, b)
        along = 0.0 if length == 0 else float(np.dot(point - a, b - a)) / length**2
        best = min(best, math.dist(point, a + min(max(along, 0.0), 1.0) * (b - a)))
    return best


@pytest.mark.parametrize("hardness", [0.0, 0.4, 1.0])
@pytest.mark.parametrize("dimensions", [2, 3])
def test_a_stroke_paints_by_the_distance_from_its_way(hardness: float, dimensions: int) -> None:
    """Oracle: the formula; the returned rows are those with more weight."""
    rng = np.random.default_rng(0)
    points = rng.uniform(0, 100, (500, dimensions))
    way = [*rng.uniform(10, 90, (4, dimensions))]
    way.insert(2, way[1])  # the mouse may rest
    brush = Brush(radius=22.0, hardness=hardness)
    stroke, reported = Stroke(points, brush), set()
    for point in way:
        before = stroke.share.copy()
        rows = stroke.to(point)
        assert set(rows) == set(np.flatnonzero(stroke.share != before))
        reported |= set(rows)
    want = [falloff(from_way(p.astype(np.float32), way), 22.0, hardness) for p in points]
    np.testing.assert_allclose(stroke.share, want, atol=2e-5)
    assert reported == set(np.flatnonzero(stroke.share)) and 50 < len(reported) < 450


def test_a_finer_way_paints_the_same() -> None:
    """Oracle: the same path with fewer points."""
    points = np.random.default_rng(1).uniform(0, 100, (2000, 2))
    brush = Brush(radius=15.0)
    one, other = Stroke(points, brush), Stroke(points, brush)
    for x in (10, 80):
        one.to(np.array([x, 50.0]))
    for x in np.linspace(10, 80, 41):
        other.to(np.array([x, 50.0]))
    np.testing.assert_allclose(one.share, other.share, atol=1e-5)


def test_targets_are_reached_in_part() -> None:
    """Oracle: interpolation from a value to its target, in float64; full weight is the target
    itself."""
    base = np.random.default_rng(2).uniform(0, 1, (6, 4)).astype(np.float32)
    share = np.array([0, 0.25, 0.5, 0.75, 1, 1])
    color = (0.9, 0.3, 0.0)
    brush = Brush(radius=1, does=COLOR, color=color, strength=0.5)
    got = brush.painted(base, share)
    target = (np.array(color) - 0.5) / SH_C0
    want = base[:, :3] + 0.5 * share[:, None] * (target - base[:, :3])
    np.testing.assert_allclose(got[:, :3], want, atol=1e-6)
    np.testing.assert_array_equal(got[:, 3], base[:, 3])
    np.testing.assert_array_equal(got[0], base[0])
    for inverted, wanted in ((False, 0.25), (True, 0.75)):
        brush = Brush(radius=1, does=OPACITY, opacity=0.25, inverted=inverted)
        got = brush.painted(base, share)
        np.testing.assert_allclose(got[:, 3], base[:, 3] + share * (wanted - base[:, 3]), atol=1e-6)
        assert (got[4:, 3] == np.float32(wanted)).all()
        np.testing.assert_array_equal(got[:, :3], base[:, :3])


@pytest.mark.parametrize(
    ("values", "word"),
    [
        ({"radius": 0}, "radius must be above 0"),
        ({"radius": math.nan}, "radius must be above 0"),
        ({"radius": 1, "hardness": 1.5}, "hardness must be between 0 and 1, got 1.5"),
        ({"radius": 1, "strength": -1}, "strength must be"),
        ({"radius": 1, "opacity": 2}, "opacity must be"),
    ],
)
def test_brushes_that_cannot_be(values: dict, word: str) -> None:
    """Oracle: the message names the value."""
    with pytest.raises(ValueError, match=word):
        Brush(**values)
