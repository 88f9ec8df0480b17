"""Gains from colours of shared points."""

import numpy as np
import pytest

from gscore.trainer.analysis.exposure import fit_gains
from gscore.trainer.analysis.photo_visit import TrackColors


def seen(truth: np.ndarray, *, points: int, each: int, noise: float, wrong: float) -> TrackColors:
    """Points that `each` neighbouring photos show, with some wrong observations."""
    rng, views = np.random.default_rng(0), len(truth)
    first = rng.integers(0, views, points)
    view = ((first[:, None] + np.arange(each)) % views).ravel()
    point = np.repeat(np.arange(points), each)
    colors = np.repeat(rng.normal(-1, 0.5, (points, 3)), each, axis=0) + truth[view]
    colors += rng.normal(0, noise, colors.shape)
    bad = rng.random(len(view)) < wrong
    colors[bad] += rng.normal(0.7, 0.5, (int(bad.sum()), 3))
    return TrackColors(view=view, point=point, log_color=colors, views=views)


def gains_of(views: int, spread: float = 0.2) -> np.ndarray:
    truth = np.random.default_rng(1).normal(0, spread, (views, 3))
    return truth - truth.mean(axis=0)


def test_gains_come_back_exactly() -> None:
    """Oracle: the gains applied to the colours, without noise, but for the prior, which has the
    weight of one observation among hundreds."""
    truth = gains_of(30)
    found = fit_gains(seen(truth, points=3000, each=3, noise=0, wrong=0), np.zeros((30, 3)))
    assert np.abs(found - truth).max() < 0.03
    found = fit_gains(seen(truth, points=3000, each=3, noise=0, wrong=0), truth)
    assert np.abs(found - truth).max() < 1e-9


def test_a_fifth_of_wrong_observations_hardly_matters() -> None:
    """Oracle: as above, with a multiple of the error for plain least squares."""
    truth = gains_of(30)
    some = seen(truth, points=3000, each=3, noise=0.05, wrong=0.2)
    assert np.abs(fit_gains(some, np.zeros((30, 3))) - truth).mean() < 0.02


def test_photos_that_share_nothing_get_what_is_expected() -> None:
    """Oracle: the prior, about the mean of all."""
    expected = gains_of(4)
    none = TrackColors(
        view=np.zeros(0, np.int64),
        point=np.zeros(0, np.int64),
        log_color=np.zeros((0, 3)),
        views=4,
    )
    np.testing.assert_allclose(fit_gains(none, expected), expected, atol=1e-12)
    lonely = TrackColors(
        view=np.array([0, 1, 3]),
        point=np.array([7, 8, 9]),
        log_color=np.zeros((3, 3)),
        views=4,
    )
    np.testing.assert_allclose(fit_gains(lonely, expected), expected, atol=1e-9)


@pytest.mark.parametrize("order", [0, 1])
def test_the_order_of_observations_does_not_matter(order: int) -> None:
    """Oracle: the same in another order."""
    truth = gains_of(10)
    some = seen(truth, points=300, each=4, noise=0.05, wrong=0.1)
    mixed = np.random.default_rng(order).permutation(len(some))
    other = TrackColors(
        view=some.view[mixed],
        point=some.point[mixed],
        log_color=some.log_color[mixed],
        views=some.views,
    )
    zeros = np.zeros((10, 3))
    np.testing.assert_allclose(fit_gains(some, zeros), fit_gains(other, zeros), atol=1e-10)
