"""Exposure of a photo: values against linear light, and its inverse."""

import numpy as np
import pytest

from gscore.photo_exposure import NEUTRAL, PhotoExposure
from tests.light_changes import exposed_by


@pytest.mark.parametrize(
    ("stops", "error"), [(-3.0, 1.5), (-1.5, 0.7), (-0.5, 0.2), (0.5, 0.2), (1.5, 1.2)]
)
def test_exposures_are_those_of_light(stops: float, error: float) -> None:
    """Oracle: sRGB values of light times 2^stops, of 255, up to white; a gain of values alone is
    off by more than three times as much."""
    gain = np.array([2 ** (stops / 2.4), 1.0, 2 ** (-stops / 2.4)])
    exposure = PhotoExposure.of(gain)
    values = np.repeat(np.linspace(0.0, 1, 1001)[:, None], 3, axis=1)
    wanted = exposed_by(values, gain)
    shown = wanted[:, 0] <= 1
    found = exposure.apply(values)
    assert 255 * np.abs(found - wanted)[shown, 0].max() < error
    assert 255 * np.abs(values * 2 ** (stops / 2.2) - wanted)[shown, 0].max() > 3 * error
    assert found[:, 1].tobytes() == values[:, 1].tobytes()
    np.testing.assert_allclose(exposure.undo(found), values, atol=1e-12)
    assert (np.diff(found, axis=0) > 0).all() and not found[0].any()


def test_a_background_is_the_same_after_the_exposure() -> None:
    """Oracles: `apply`; differences for the slope. The neutral exposure changes no bit."""
    exposure = PhotoExposure.of([0.5, 1.3, 2.0])
    behind = np.array(exposure.behind((0.2, 0.0, 1.0)))
    faster = PhotoExposure.of(exposure.gain * np.exp(1e-6)).behind((0.2, 0.0, 1.0))
    slope = exposure.behind_by_log_gain((0.2, 0.0, 1.0))
    np.testing.assert_allclose((np.array(faster) - behind) / 1e-6, slope, atol=1e-5)
    np.testing.assert_allclose(exposure.apply(behind), (0.2, 0.0, 1.0), atol=1e-12)
    assert not exposure.neutral and NEUTRAL.neutral
    values = np.random.default_rng(0).random((4, 5, 3), np.float32)
    assert NEUTRAL.apply(values).tobytes() == values.tobytes()
    half = np.full((4, 5, 1), 0.5, np.float32)
    np.testing.assert_allclose(
        exposure.apply(values * half, half), exposure.apply(values) / 2, atol=1e-6
    )
    assert exposure.apply(values).dtype == exposure.undo(values).dtype == np.float32


def test_exposures_without_offsets_are_gains_of_values() -> None:
    """Oracles: the product; a search for the nearest exposure of light."""
    gain = np.array([0.7, 1.0, 1.4])
    values = np.random.default_rng(0).random((40, 50, 3), np.float32)
    old = PhotoExposure(gain, np.zeros(3))
    assert old.apply(values).tobytes() == (values * gain.astype(np.float32)).tobytes()
    np.testing.assert_allclose(old.undo(values), values / gain, rtol=1e-6)
    tried = np.linspace(0.5, 1.5, 10001)
    levels = np.linspace(0.0, 1.0, 33)[:, None]
    for channel in range(3):
        errors = (levels + 0.055) * tried - 0.055 - levels * gain[channel]
        best = tried[(errors**2).sum(axis=0).argmin()]
        assert abs(old.nearest_gain[channel] - best) <= 1e-4
    np.testing.assert_allclose(PhotoExposure.of(gain).nearest_gain, gain, rtol=1e-12)
