"""Isolation of splats, against all distances."""

import numpy as np
import pytest

from gscore.edit import isolation_of
from gscore.edit.measures import NEIGHBOURS


def slowly(means: np.ndarray) -> np.ndarray:
    """By all distances."""
    apart = np.linalg.norm(means[:, None] - means[None], axis=2)
    near = np.argsort(apart, axis=1)[:, 1 : NEIGHBOURS + 1]
    reach = np.sort(apart, axis=1)[:, NEIGHBOURS]
    return reach / np.median(reach[near], axis=1)


def test_equals_all_distances() -> None:
    """Oracle: all distances, in float64."""
    means = np.random.default_rng(0).normal(size=(400, 3)).astype(np.float32)
    np.testing.assert_allclose(isolation_of(means), slowly(means.astype(np.float64)), rtol=1e-6)


def test_only_what_floats_stands_out() -> None:
    """Oracle: a dense and a sparse ball, a hundred times apart in scale, and one splat between; no
    splat of a ball is as far from the others as four times the usual distance there."""
    rng = np.random.default_rng(1)
    dense, sparse = rng.uniform(-1, 1, (2, 1000, 3))
    means = np.concatenate([dense, 100 * sparse + 300, [[20.0, 0, 0]]]).astype(np.float32)
    found = isolation_of(means)
    assert found[-1] > 50 and found[:-1].max() < 4


def test_threads_change_nothing() -> None:
    """Oracle: bit equality."""
    means = np.random.default_rng(2).normal(size=(3000, 3)).astype(np.float32)
    assert isolation_of(means, threads=1).tobytes() == isolation_of(means, threads=2).tobytes()


@pytest.mark.parametrize("count", [0, 1, NEIGHBOURS])
def test_too_few_to_tell(count: int) -> None:
    """Oracle: ones."""
    assert isolation_of(np.zeros((count, 3), np.float32)).tolist() == [1] * count


def test_copies_in_one_place() -> None:
    """Oracle: splats on top of each other, which are not isolated; a splat next to them is."""
    means = np.zeros((20, 3), np.float32)
    means[-1] = 1
    found = isolation_of(means)
    assert (found[:-1] == 0).all() and found[-1] > 1e6
