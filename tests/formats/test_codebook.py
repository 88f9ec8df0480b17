"""Codebooks and palettes. Oracle: the encoded values, and theoretical bounds of quantisers."""

import numpy as np
import pytest

from gscore.formats.textures import codebook, nearest_entries, palette
from gscore.morton import morton_order


def test_a_codebook_is_as_good_as_lloyds() -> None:
    """Oracle: Panter and Dite's bound for 256 levels of a normal distribution, met within 5 %."""
    values = np.random.default_rng(0).standard_normal(200_000).astype(np.float32)
    book = codebook(values)
    error = np.mean((book[nearest_entries(book, values)] - values) ** 2)
    bound = np.pi * np.sqrt(3) / 2 / 256**2
    assert error < 1.05 * bound
    assert (np.diff(book) >= 0).all() and len(book) == 256


@pytest.mark.parametrize("values", [[], [2.5], [2.5] * 9, [-1.0, 1.0], list(range(100))])
def test_few_values_are_kept(values: list[float]) -> None:
    """Oracle: the values themselves, to a thousandth of their range."""
    array = np.array(values, np.float32)
    book = codebook(array)
    found = book[nearest_entries(book, array)]
    assert np.abs(found - array).max(initial=0) <= 1e-3 * max(
        np.ptp(array) if len(values) else 0, 0
    )


@pytest.mark.parametrize("count", [0, 1, 1024])
def test_small_palettes_are_the_rows(count: int) -> None:
    """Oracle: the rows."""
    rows = np.random.default_rng(1).standard_normal((count, 9)).astype(np.float32)
    found, labels = palette(rows)
    np.testing.assert_array_equal(found[labels], rows)


@pytest.mark.parametrize("count", [1025, 4096, 5000, 140_000])
def test_a_palette_stands_for_all_rows(count: int) -> None:
    """Oracle: the means of the rows with a label; sizes; an error far below that of one mean."""
    rng = np.random.default_rng(2)
    rows = (rng.standard_normal((count, 6)) @ rng.standard_normal((6, 9))).astype(np.float32) / 100
    found, labels = palette(rows)
    assert count / 4 <= len(found) <= count / 2 or len(found) == 65_536
    assert len(labels) == count and labels.max() < len(found)
    some = labels == labels[count // 3]
    assert 1 <= some.sum() <= 5
    near = np.abs(rows[some].mean(axis=0) - found[labels[count // 3]]).max()
    assert near < 0.5 * rows.std()  # the last group may repeat a row
    error = np.mean((found[labels] - rows) ** 2)
    assert error < 0.15 * rows.var()


def test_morton_order_keeps_neighbours() -> None:
    """Oracle: the mean distance from each point to the next, against that of a random order."""
    points = np.random.default_rng(3).random((5000, 3), dtype=np.float32)
    order = morton_order(points)
    assert sorted(order) == list(range(5000))
    steps = np.linalg.norm(np.diff(points[order], axis=0), axis=1).mean()
    assert steps < 0.15 * np.linalg.norm(np.diff(points, axis=0), axis=1).mean()
    far = np.concatenate([points, [[1e6, 0, 0]]]).astype(np.float32)
    again = np.linalg.norm(np.diff(far[morton_order(far)], axis=0), axis=1)
    assert np.median(again) < 2 * steps
