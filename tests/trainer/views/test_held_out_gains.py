"""Gains of held-out photos, predicted from those of the training photos."""

import numpy as np
import pytest

from gscore.trainer.views.photo_gains import STOP, HeldOutGains

COUNT = 60
NAMES = [f"IMG_{i + 5}.jpg" for i in range(COUNT)]  # numbers of one and two digits
TEST = np.arange(COUNT) % 8 == 4
TRAIN = np.flatnonzero(~TEST)
RNG = np.random.default_rng(4)


def error(truth: np.ndarray, centers: np.ndarray, stops: np.ndarray | None = None) -> np.ndarray:
    """Errors of held-out photos, stops; their own gains are NaN for the prediction."""
    truth = truth - truth[TRAIN].mean(axis=0)
    given = np.where(TEST[:, None], np.nan, truth)
    found = HeldOutGains(NAMES, centers, [*TRAIN], stops=stops).predict(given)
    return np.abs(found - truth)[TEST] / STOP


@pytest.mark.parametrize("along", ["names", "places"])
def test_gains_that_change_smoothly_are_recovered(along: str) -> None:
    """Oracle: gains of up to 1.5 stops as a smooth function of the name or of the place."""
    order = RNG.permutation(COUNT)
    angle = 2 * np.pi * (np.arange(COUNT) if along == "names" else order) / COUNT
    centers = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    if along == "names":
        centers = RNG.normal(size=(COUNT, 3))
    truth = 1.5 * STOP * np.sin(angle)[:, None] * [1.0, 0.9, 0.8]
    assert error(truth, centers).max() < 0.15


def test_stated_exposures_are_used() -> None:
    """Oracle: random exposures, in stops."""
    stops = RNG.uniform(-1.5, 1.5, COUNT)
    truth, centers = np.repeat(STOP * stops[:, None], 3, axis=1), RNG.normal(size=(COUNT, 3))
    assert error(truth, centers, stops).max() < 0.02
    unknown = np.where(np.arange(COUNT) == 4, np.nan, stops)
    assert error(truth, centers, unknown).max() == error(truth, centers).max()


def test_unrelated_gains_are_not_predicted() -> None:
    """Oracle: the mean exposure, of which an error of random gains is their own size."""
    truth, centers = STOP * RNG.normal(size=(COUNT, 3)), RNG.normal(size=(COUNT, 3))
    given = truth - truth[TRAIN].mean(axis=0)
    found = HeldOutGains(NAMES, centers, [*TRAIN]).predict(given)[TEST]
    assert np.abs(found).max() < 0.5 * STOP
    assert np.sqrt((found**2).mean()) < 0.2 * np.sqrt((given**2).mean())


@pytest.mark.parametrize("train", [[2], [2, 0]])
def test_few_photos(train: list[int]) -> None:
    """Oracle: finite gains; with one photo that of all, zero."""
    gains = np.array([[0.1], [np.nan], [-0.1]]).repeat(3, axis=1)
    gains[train] -= gains[train].mean(axis=0)
    found = HeldOutGains(["a", "b", "c"], np.zeros((3, 3)), train).predict(gains)
    assert np.isfinite(found).all() and np.abs(found).max() <= 0.1
