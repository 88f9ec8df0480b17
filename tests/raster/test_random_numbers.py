"""Random numbers by key; oracle: published vectors, the twin in Python, and closed forms."""

import math

import numpy as np
import pytest
import torch

from gscore.errors import ShapeError
from gscore.raster import _native
from gscore.raster.random_numbers import normal_rows, uniform_rows
from gscore.raster.reference import random_numbers as twin

KEY = {"seed": 0x123456789ABCDEF0, "step": 77, "stream": 5}
VECTORS = [
    ("00000000 00000000 00000000 00000000", "00000000 00000000"),
    ("ffffffff ffffffff ffffffff ffffffff", "ffffffff ffffffff"),
    ("243f6a88 85a308d3 13198a2e 03707344", "a4093822 299f31d0"),
]
WORDS = [
    "6627e8d5 e169c58d bc57ac4c 9b00dbd8",
    "408f276d 41c83b0e a20bc7c6 6d5451fd",
    "d16cfe09 94fdcceb 5001e420 24126ea1",
]
"""Known answers of Philox 4x32-10 in Random123's kat_vectors."""


def of_hex(text: str) -> np.ndarray:
    return np.array([int(word, 16) for word in text.split()], np.uint32)


@pytest.mark.parametrize(("given", "expected"), list(zip(VECTORS, WORDS, strict=True)))
def test_blocks_are_the_published_ones(given: tuple[str, str], expected: str) -> None:
    """Oracle: the known answers, of the library and of the twin."""
    counter, key = map(of_hex, given)
    np.testing.assert_array_equal(_native.philox(counter, key), of_hex(expected))
    np.testing.assert_array_equal(twin.philox(counter, key), of_hex(expected))


@pytest.mark.parametrize("count", [0, 1, 255, 257, 9000])
def test_uniform_numbers_have_the_bits_of_the_twin(count: int) -> None:
    """Oracle: the twin, for any number of threads."""
    expected = twin.uniform(twin.row_words(np.arange(count), **KEY))
    for threads in (1, 3):
        found = uniform_rows(count, **KEY, threads=threads).numpy()
        np.testing.assert_array_equal(found, expected)


def test_normal_numbers_are_close_to_the_twin() -> None:
    """Oracle: the scalar twin in double precision, within 1e-6; a row has its numbers in any order
    and on any number of threads."""
    rows = np.concatenate([np.arange(4500), [2**31 - 2, 7]])
    found = normal_rows(torch.from_numpy(rows), **KEY, threads=1).numpy()
    words = twin.row_words(rows, **KEY).tolist()
    expected = np.array([twin.normal(tuple(row)) for row in words])
    assert np.abs(found - expected).max() < 1e-6
    again = normal_rows(torch.from_numpy(rows[::-1].copy()), **KEY, threads=3).numpy()
    np.testing.assert_array_equal(again[::-1], found)


def test_normal_numbers_are_normal() -> None:
    """Oracle: the first four moments of three independent standard normal numbers."""
    found = normal_rows(torch.arange(200_000), **KEY).double().numpy()
    assert np.abs(found.mean(axis=0)).max() < 0.01
    np.testing.assert_allclose(np.cov(found.T), np.eye(3), atol=0.01)
    assert np.abs((found**3).mean(axis=0)).max() < 0.03
    np.testing.assert_allclose((found**4).mean(axis=0), 3, atol=0.08)


def test_streams_steps_and_seeds_are_independent() -> None:
    """Oracle: no correlation between the numbers of two keys that differ in one part."""
    one = uniform_rows(50_000, **KEY).double().numpy()
    for name in KEY:
        other = uniform_rows(50_000, **KEY | {name: KEY[name] + 1}).double().numpy()
        assert abs(np.corrcoef(one, other)[0, 1]) < 0.02, name


def test_the_ends_of_the_formula() -> None:
    """Oracle: the twin, for the smallest and largest radius and the borders of the quadrants."""
    words = [0, 0xFF, 0x100, 0xFFFFFFFF, 0x3FFFFFFF, 0x40000000, 0x7FFFFFFF, 0x80000000, 0xC0000000]
    for word in words:
        values = twin.normal((word, word, word, word))
        assert all(map(math.isfinite, values))
        assert max(map(abs, values)) <= 5.768


def test_other_arrays_are_refused() -> None:
    """Oracle: ShapeError, before the library is called."""
    with pytest.raises(ShapeError, match="rows must be"):
        normal_rows(torch.zeros(3, dtype=torch.int32), **KEY)
    with pytest.raises(ShapeError, match="threads"):
        uniform_rows(3, **KEY, threads=-1)
