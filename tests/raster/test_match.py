"""Feature matches; oracles: all distances in float64, and pairs known beforehand."""

from collections.abc import Iterator

import numpy as np
import pytest

from gscore.errors import ShapeError
from gscore.raster import _native, header
from gscore.raster.match import match_descriptors
from tests.raster.twins.match import match_descriptors as twin

NEAR = {"max_distance": 0.7 * 512, "max_ratio": 0.8}


@pytest.fixture(params=_native.available_isas(), autouse=True)
def isa(request: pytest.FixtureRequest) -> Iterator[None]:
    before = _native.isa()
    _native.set_isa(request.param)
    yield
    _native.set_isa(before)


def descriptors(rng: np.random.Generator, count: int) -> np.ndarray:
    """Like SIFT's: few large numbers, 512 long."""
    values = rng.exponential(size=(count, header.DESCRIPTOR_SIZE)) ** 2
    return np.minimum(512 * values / np.linalg.norm(values, axis=1)[:, None], 255).astype(np.uint8)


@pytest.mark.parametrize("counts", [(200, 300), (6, 32), (7, 33), (31, 1), (1, 1), (0, 9), (9, 0)])
def test_matches_are_those_of_all_distances(counts: tuple[int, int]) -> None:
    """Oracle: the twin; the second photo shows half of the first one's features, disturbed."""
    rng = np.random.default_rng(counts[0])
    first, second = (descriptors(rng, n) for n in counts)
    shown = min(counts) // 2
    noise = rng.integers(-20, 20, (shown, header.DESCRIPTOR_SIZE))
    second[rng.permutation(counts[1])[:shown]] = np.clip(first[:shown] + noise, 0, 255)
    found = match_descriptors(first, second, **NEAR)
    np.testing.assert_array_equal(found, twin(first, second, **NEAR))
    assert found.dtype == np.int32 and len(found) >= shown * 0.8
    back = match_descriptors(second, first, **NEAR)[:, ::-1]
    np.testing.assert_array_equal(back[back[:, 0].argsort()], found)


@pytest.mark.parametrize("limits", [(1e9, 1.0), (30.0, 1.0), (1e9, 0.5), (0.0, 0.8), (1e9, 0.0)])
def test_limits_are_those_asked_for(limits: tuple[float, float]) -> None:
    rng = np.random.default_rng(5)
    first = descriptors(rng, 90)
    second = np.clip(first + rng.integers(-9, 9, first.shape), 0, 255).astype(np.uint8)
    second[:5] = first[:5]
    asked = {"max_distance": limits[0], "max_ratio": limits[1]}
    found = match_descriptors(first, second, **asked)
    np.testing.assert_array_equal(found, twin(first, second, **asked))


def test_duplicate_descriptors_have_no_match() -> None:
    """Oracle: no match between equal distances, which are ambiguous."""
    first = descriptors(np.random.default_rng(1), 12)
    twice = np.concatenate([first[:4], first])
    found = match_descriptors(first, twice, **NEAR)
    np.testing.assert_array_equal(found[:, 0], np.arange(4, 12))


def test_largest_distance_is_exact() -> None:
    """Oracle: their distance, 255 sqrt(128), the largest possible."""
    first = np.zeros((3, header.DESCRIPTOR_SIZE), np.uint8)
    second = np.full((1, header.DESCRIPTOR_SIZE), 255, np.uint8)
    far = 255 * 128**0.5
    assert len(match_descriptors(first[:1], second, max_distance=far + 1e-9, max_ratio=1)) == 1
    assert len(match_descriptors(first[:1], second, max_distance=far - 1e-9, max_ratio=1)) == 0
    assert len(match_descriptors(first, second, max_distance=far + 1e-9, max_ratio=1)) == 0


@pytest.mark.parametrize(
    "bad",
    [
        np.zeros((4, 128), np.float32),
        np.zeros((4, 64), np.uint8),
        np.zeros(128, np.uint8),
        np.zeros((4, 256), np.uint8)[:, ::2],
    ],
)
def test_other_arrays_are_refused(bad: np.ndarray) -> None:
    good = np.zeros((4, 128), np.uint8)
    with pytest.raises(ShapeError, match=r"first must be \[\d+, 128\] uint8"):
        match_descriptors(bad, good, **NEAR)
    with pytest.raises(ShapeError, match="second"):
        match_descriptors(good, bad, **NEAR)


def test_other_limits_are_refused() -> None:
    good = np.zeros((4, 128), np.uint8)
    for limits in ({"max_distance": -1.0}, {"max_ratio": 1.1}, {"max_ratio": float("nan")}):
        with pytest.raises(ShapeError, match="max_distance must be 0 or more"):
            match_descriptors(good, good, **(NEAR | limits))
